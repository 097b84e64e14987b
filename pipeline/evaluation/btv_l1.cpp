// OpenCV's BTV-L1 (cv::superres) as a program: grey frames in, one of them doubled out.
//
// btv-l1 WIDTH HEIGHT FRAMES REFERENCE SIGMA: rows of bytes, frame after frame, on standard
// input; the frame REFERENCE, of 2 * HEIGHT rows of 2 * WIDTH bytes, on standard output. SIGMA is
// that of the Gaussian PSF, HR pixels. The method gives no pixels within 7 of the border: there
// the last are repeated. `make peers` builds it; btv_l1.py runs it.

#include <algorithm>
#include <cstddef>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <stdexcept>
#include <utility>
#include <vector>

#include <opencv2/core.hpp>
#include <opencv2/superres.hpp>

namespace {

const int kSupport = 7;  // of the PSF and of the prior, HR pixels

class Frames : public cv::superres::FrameSource {
 public:
  explicit Frames(std::vector<cv::Mat> frames) : frames_(std::move(frames)) {}

  void nextFrame(cv::OutputArray frame) override {
    if (next_ < frames_.size())
      frames_[next_++].copyTo(frame);
    else
      frame.release();
  }

  void reset() override { next_ = 0; }

 private:
  std::vector<cv::Mat> frames_;
  std::size_t next_ = 0;
};

std::vector<cv::Mat> read(int width, int height, int count) {
  std::vector<cv::Mat> frames;
  for (int number = 0; number < count; ++number) {
    cv::Mat frame(height, width, CV_8UC1);
    if (std::fread(frame.data, 1, frame.total(), stdin) != frame.total())
      throw std::runtime_error("standard input ends too early");
    frames.push_back(frame);
  }
  return frames;
}

// The reference from all frames: the window of 2 * radius + 1 around it begins with the first.
cv::Mat doubled(std::vector<cv::Mat> frames, int reference, double sigma) {
  const int radius = std::max(static_cast<int>(frames.size()) / 2, reference);
  cv::Ptr<cv::superres::SuperResolution> method = cv::superres::createSuperResolution_BTVL1();
  method->setScale(2);
  method->setKernelSize(kSupport);
  method->setBlurKernelSize(kSupport);
  method->setBlurSigma(sigma);
  method->setTemporalAreaRadius(radius);
  method->setOpticalFlow(cv::superres::createOptFlow_Farneback());
  method->setInput(cv::makePtr<Frames>(std::move(frames)));
  cv::Mat picture;
  for (int number = 0; number <= reference; ++number) method->nextFrame(picture);
  cv::Mat whole;
  cv::copyMakeBorder(picture, whole, kSupport, kSupport, kSupport, kSupport, cv::BORDER_REPLICATE);
  return whole;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    if (argc != 6) throw std::runtime_error("wants WIDTH HEIGHT FRAMES REFERENCE SIGMA");
    const int width = std::atoi(argv[1]), height = std::atoi(argv[2]);
    const int count = std::atoi(argv[3]), reference = std::atoi(argv[4]);
    if (width < 1 || height < 1 || count < 2 || reference < 0 || reference >= count)
      throw std::runtime_error("wants two frames or more, and one of them");
    const cv::Mat picture = doubled(read(width, height, count), reference, std::atof(argv[5]));
    if (std::fwrite(picture.data, 1, picture.total(), stdout) != picture.total() ||
        std::fflush(stdout) != 0)
      throw std::runtime_error("standard output is closed");
  } catch (const std::exception& error) {
    std::fprintf(stderr, "btv-l1: %s\n", error.what());
    return 1;
  }
  return 0;
}
