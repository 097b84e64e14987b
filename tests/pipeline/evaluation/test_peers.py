"""Peers: geometry, what is absent, what the chapter says; the networks where they are installed."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import scipy.io

from pipeline.config import Settings
from pipeline.errors import ConfigurationError
from pipeline.evaluation import home_ground, networks, peers, rivals
from pipeline.evaluation.kept import made_once
from pipeline.evaluation.methods import Accounted, fidelity
from pipeline.evaluation.rivals import Given, Peer
from pipeline.superresolve import superresolve
from tests.support.needed import absent

GIVEN = Given(noise=0.0, sigma=1.0, threads=1)


def waves(shape, offset):
    """A smooth picture; at an offset along both axes, pixels."""
    rows, columns = np.mgrid[: shape[0], : shape[1]] + offset
    return (120 + 50 * np.sin(rows / 5) + 40 * np.cos(columns / 7 + rows / 9)).astype(np.float32)


def test_half_a_pixel_is_undone():
    moved = rivals.moved_half(waves((60, 84), 0.0))
    inner = (slice(8, -8), slice(8, -8))
    assert np.abs(moved - waves((60, 84), 0.5))[inner].max() < 0.1


def test_the_halving_keeps_means_and_sits_between_pixels():
    image = np.rint(waves((64, 96), 0.0)).astype(np.uint8)
    small = home_ground.halved(image, 0.0, np.random.default_rng(0))
    assert small.shape == (32, 48)
    rows, columns = np.mgrid[:32, :48] * 2 + 0.5
    wanted = 120 + 50 * np.sin(rows / 5) + 40 * np.cos(columns / 7 + rows / 9)
    assert np.abs(small - wanted)[4:-4, 4:-4].max() < 2


def test_the_halving_is_that_of_an_antialiased_resizer():
    """An impulse comes back with the taps of the stretched cubic, at both phases."""
    taps = home_ground.halving_taps()
    assert taps.sum() == pytest.approx(1)
    for place in (20, 21):
        image = np.zeros((40, 40), np.uint8)
        image[place] = 200
        column = home_ground.halved(image, 0.0, np.random.default_rng(0))[:, 9]
        centres = 2 * np.arange(20) + 0.5
        wanted = [
            200 * taps[int(place - centre + 3.5)] if -4 < place - centre < 4 else 0
            for centre in centres
        ]
        assert np.abs(column - np.clip(np.rint(wanted), 0, 255)).max() <= 1


def test_a_kernel_and_the_halving_together_blur_as_asked():
    sigma = home_ground.kernel_before_halving(1.0)
    assert 0.6 < sigma < 0.85
    assert home_ground.kernel_before_halving(1.7) > sigma


@pytest.mark.parametrize("peer", rivals.PEERS[:6], ids=lambda peer: peer.name)
def test_resizers_align_pixel_areas(peer):
    small = np.rint(waves((40, 56), 0.0))
    doubled = peer.run(small, GIVEN)
    assert doubled.shape == (80, 112)
    rows, columns = (np.mgrid[:80, :112] + 0.5) / 2 - 0.5
    wanted = 120 + 50 * np.sin(rows / 5) + 40 * np.cos(columns / 7 + rows / 9)
    assert np.abs(doubled - wanted)[8:-8, 8:-8].max() < 2.5


def test_srmd_is_told_its_kernel_by_principal_components(tmp_path):
    generator = np.random.default_rng(1)
    matrix = generator.normal(size=(15, 225)).astype(np.float32)
    scipy.io.savemat(tmp_path / "pca.mat", {"P": matrix})
    kernel = cv2.getGaussianKernel(15, 1.3)
    wanted = matrix @ (kernel @ kernel.T).ravel()
    found = rivals.srmd_numbers(1.3, tmp_path / "pca.mat")
    assert np.allclose(found, wanted, atol=1e-5)
    (tmp_path / "bad.mat").write_text("nothing of the kind")
    with pytest.raises(ConfigurationError, match="no MATLAB file with a matrix P"):
        rivals.srmd_numbers(1.3, tmp_path / "bad.mat")


def test_folders_and_files_that_are_not_there_are_named(monkeypatch, tmp_path):
    monkeypatch.setenv("DEPTHSR_PEERS", str(tmp_path / "none"))
    with pytest.raises(ConfigurationError, match="DEPTHSR_PEERS"):
        networks.packages_folder()
    monkeypatch.setenv("DEPTHSR_SRMD_PCA", str(tmp_path / "none.mat"))
    with pytest.raises(ConfigurationError, match="DEPTHSR_SRMD_PCA"):
        rivals.pca_file()


@pytest.fixture(scope="module")
def rows(subject):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(networks, "package_path", lambda package: None)
        return peers.measure_peers(subject, peers.input_kinds((1.0,), (2.0,)))


def test_what_a_network_made_is_kept_for_the_same_weights_picture_and_noise(tmp_path, monkeypatch):
    monkeypatch.delenv("DEPTHSR_SRMD_PCA", raising=False)
    monkeypatch.setenv("DEPTHSR_PEERS", str(tmp_path))
    weights = tmp_path / "maker" / "model.bin"
    weights.parent.mkdir()
    weights.write_bytes(b"one")
    weights.with_suffix(".param").write_bytes(b"layers")
    network = networks.Network(package="maker", path="model", input="in", output="out")
    peer = Peer(name="p", run=lambda image, given: image, missing=str, networks=(network,))
    image, made = waves((8, 12), 0.0), []

    def make():
        made.append(1)
        return Accounted(
            result=np.full((16, 24), len(made), np.uint8), seconds=0.5, cpu_seconds=0.7,
            memory_mib=float("nan"),
        )  # fmt: skip

    def asked(peer=peer, image=image, given=GIVEN, folder=tmp_path / "kept"):
        found = made_once(peer, image, given, folder, make)
        assert (found.seconds, found.cpu_seconds) == (0.5, 0.7)
        return int(found.result[0, 0])

    assert [asked(), asked()] == [1, 1]
    assert asked(image=image + 1) == 2
    assert asked(given=replace(GIVEN, noise=2.0)) == 3
    weights.write_bytes(b"two")
    assert [asked(), asked()] == [4, 4]
    assert [asked(folder=None), asked(peer=replace(peer, networks=()))] == [5, 6]


def test_absent_packages_say_so_and_the_others_are_measured(rows):
    absent = {row.method for row in rows if row.remark == "not installed"}
    assert absent >= {"SPAN x2 ch48", "animevideov3 x2", "SRMD, blind", "waifu2x upconv7 photo"}
    assert {row.input_name for row in rows} == {"Gaussian 1, noise 2", "bicubic, noise 2"}
    for kind in ("Gaussian 1, noise 2", "bicubic, noise 2"):
        found = {row.method: row for row in rows if row.input_name == kind}
        assert found["default"].psnr > found["OpenCV cubic"].psnr > 20
        # the same kernel at the same phase as our own baseline: nothing is left of half a pixel
        assert abs(found["OpenCV cubic"].psnr - found["bicubic"].psnr) < 0.35
    text = " ".join(peers.chapter(rows).answer)
    assert "SPAN x2 ch48: not installed" in text


def test_the_chapter_says_who_wins(rows):
    measured = [replace(row, num_views=5) for row in rows if not row.remark]
    won = peers.chapter(measured).answer
    assert "Yes: in 2 of 2 cells by PSNR and in 2 by SSIM" in won[0]
    assert not any("A peer wins" in sentence for sentence in won)
    turned = [
        replace(row, psnr=60.0) if row.method == "swscale lanczos" and row.sigma else row
        for row in measured
    ]
    lost = peers.chapter(turned).answer
    assert "No: in 1 of 2 cells by PSNR" in lost[0]
    assert "against swscale lanczos" in lost[0]
    assert any(
        "A peer wins on sample (Gaussian 1, noise 2, 5 views): swscale lanczos, 60.00 dB" in said
        for said in lost
    )
    assert "At 4 views" not in " ".join(peers.chapter(rows).answer)  # the scene has three


def test_the_middle_lies_in_the_middle_on_even_pixels():
    assert peers._middle_of((191, 276)) == (90, 58, 96, 72)


def _middle(scene: str, peer: str, ours: float, theirs: float) -> peers.MiddleRow:
    psnr = {peer: theirs, "bicubic": 20.0, "single-view": 21.0, "default": ours}
    return peers.MiddleRow(
        scene=scene, num_views=8, input_name="Gaussian 1, noise 2", peer=peer, psnr=psnr,
        ssim=dict.fromkeys(psnr, 0.5), cpu_seconds=9.0, memory_mib=70.0,
    )  # fmt: skip


def test_the_chapter_says_who_wins_in_the_middle(rows):
    absent_one = replace(_middle("c", "vidsr", 1, 1), psnr={}, ssim={}, remark="not installed")
    middles = [
        _middle("a", "vidsr", 30.0, 28.0), _middle("a", "BTV-L1", 30.0, 27.0),
        _middle("b", "vidsr", 30.0, 31.0), absent_one,
    ]  # fmt: skip
    chapter = peers.chapter(rows, middles)
    said = " ".join(chapter.answer)
    assert "Against vidsr, which" in said
    assert "wins 1 of 2 cells on the middle 96×72 LR pixels, by -1.00 to +2.00 dB" in said
    assert "wins 1 of 1 cells on the middle 96×72 LR pixels, by +3.00 to +3.00 dB" in said
    assert "Not measured: vidsr: not installed" in said
    table = chapter.tables[1][1]
    assert [row[-1] for row in table.rows] == ["", "", "", "not installed"]
    assert table.rows[1][3:5] == ("BTV-L1", "27.00")


@pytest.mark.parametrize("peer", rivals.PEERS[6:11], ids=lambda peer: peer.name)
def test_networks_align_pixel_areas(peer):
    if peer.missing():
        absent(f"{peer.name}: {peer.missing()}; `make peers`, DEPTHSR_PEERS")
    small = np.rint(waves((32, 40), 0.0))
    doubled = peer.run(small, Given(noise=2.0, sigma=1.0, threads=1))
    rows, columns = (np.mgrid[:64, :80] + 0.5) / 2 - 0.5
    wanted = 120 + 50 * np.sin(rows / 5) + 40 * np.cos(columns / 7 + rows / 9)
    assert doubled.shape == wanted.shape
    inner = (slice(8, -8), slice(8, -8))

    def off(image):
        difference = (image - wanted)[inner]
        assert abs(difference.mean()) < 5  # the one for drawings makes greys brighter, and flattens
        return np.abs(difference - difference.mean()).mean()

    assert off(doubled) < 2
    assert off(doubled) < off(rivals.moved_half(doubled))  # its own phase, not half a pixel off


def test_the_kernel_of_the_halving_is_worth_knowing(subject):
    """Against the Gaussian that passes frequencies most alike."""
    made, eye = home_ground.home_frame(subject, 0.0), subject.eyes[0]
    known = home_ground.home_settings(Settings())
    guessed = replace(known, psf="given", psf_sigma=home_ground.HALVING.sigma)
    psnr = {}
    for settings in (known, guessed):
        image = superresolve(made.frame, settings, targets=(eye,)).images[eye].luma
        psnr[settings.psf] = fidelity(image, made.truth[eye], 8).psnr
    assert psnr["bicubic"] > psnr["given"] + 0.5


def test_home_frames_are_worked_on_at_their_own_phase(subject):
    settings = home_ground.home_settings(Settings())
    assert settings.sampling == "area"
    frame = home_ground.home_frame(subject, 0.0).frame
    assert all(view.depth_map is not None for view in frame.views)
