"""Scenes and videos in, videos and pictures out.

* what lies on disk: :mod:`scene`, recognised by :mod:`layouts`: a :mod:`manifest`, :mod:`datasets`,
  :mod:`stereo_video`, :mod:`eye_files`; :mod:`info` and :mod:`probe` say what was understood of it;
* its frames: :mod:`source`, :mod:`scene_source`, with :mod:`readers` over :mod:`decode`
  (:mod:`decoded`), :mod:`images` and :mod:`yuv` (:mod:`chroma_kernels`); nearness by
  :mod:`depth_maps`, missing depth by :mod:`depth_estimation`, :mod:`stereo_matching` and
  :mod:`rectification`;
* what is written: :mod:`media_sink` with :mod:`encode`, :mod:`join`, :mod:`png`, :mod:`sound`,
  :mod:`matroska`, :mod:`isobmff`, :mod:`timecode`, :mod:`files`; kinds of video are
  :mod:`video_format`; :mod:`lossless` clips for browsers;
* colours: :mod:`colorimetry`, :mod:`ycbcr`, and :mod:`coded` without RGB between;
* live: :mod:`cameras` and :mod:`instants`, :mod:`live_source`, :mod:`live_manifest`,
  :mod:`live_frames`, :mod:`live_encode`, :mod:`live_file`, :mod:`jpeg`;
* :mod:`swscale`: what players enlarge with, for comparison.
"""
