"""The studies find what is known to be true of the rendered scene, or of pictures made for it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from pipeline.config import Settings
from pipeline.degradation import Degradation
from pipeline.errors import ConfigurationError
from pipeline.evaluate import BORDER
from pipeline.evaluation import ablations, fidelity, left_out, registrations, sensitivity, spectra
from pipeline.evaluation.methods import fidelity as fidelity_of
from pipeline.evaluation.subjects import open_subject
from pipeline.synthetic import SampleScene, write_scene


@pytest.fixture(scope="module")
def rows(subject):
    condition = fidelity.Condition(psf_sigma=1.0, noise=2.0, seeds=(1, 2))
    return fidelity.measure_rows(subject, [condition])


def test_every_method_is_measured_on_both_eyes_and_the_seeds_where_they_matter(rows):
    first = [row.method for row in rows if row.seed == 1]
    assert first == list(fidelity.METHODS)
    assert [row.method for row in rows if row.seed == 2] == list(fidelity.SEED_METHODS)
    assert all(len(row.psnr) == 2 and row.num_views == 3 for row in rows)


def test_the_default_beats_bicubic_and_one_view_on_the_rendered_scene(rows):
    by_method = {row.method: row for row in rows if row.seed == 1}
    assert by_method["default"].mean_psnr > by_method["single-view"].mean_psnr
    assert by_method["default"].mean_psnr > by_method["bicubic"].mean_psnr + 1
    assert by_method["default"].binocular > by_method["single-view"].binocular


def test_the_chapter_says_what_its_rows_say(rows):
    chapter = fidelity.chapter(rows)
    gain = [
        row.mean_psnr for method in ("default", "bicubic")
        for row in rows if row.seed == 1 and row.method == method
    ]  # fmt: skip
    assert f"{gain[0] - gain[1]:+.2f} dB" in chapter.answer[0]
    assert "wins 1 of 1 cells" in chapter.answer[0]
    seeds = chapter.tables[2][1]
    assert [row[3] for row in seeds.rows] == ["over bicubic", "over single-view"]
    assert all(row[4] == "2" for row in seeds.rows)


def test_between_the_eyes_the_same_surface_is_met(subject):
    truth = subject.degraded(Degradation(psf_sigma=1.0)).truth
    left, right = (truth[eye].astype(np.float32) for eye in subject.eyes)
    between = subject.between_eyes
    x, y = between.position[..., 0], between.position[..., 1]
    inside = between.seen & (x > 1) & (x < 253) & (y > 1) & (y < 189)
    assert inside.mean() > 0.6
    met = right[np.rint(y[inside]).astype(int), np.rint(x[inside]).astype(int)]
    unmoved = right[inside]
    assert np.median(np.abs(met - left[inside])) < np.median(np.abs(unmoved - left[inside])) / 2


def test_methods_of_table_1_are_measured_against_true_motion(subject):
    found, figures = registrations.measure_methods(subject)
    by_name = {row.method: row for row in found}
    assert "calibration-only" not in by_name  # the rendered scene withholds its calibration
    assert by_name["default"].errors.median_visible < 0.1
    assert by_name["default"].verified > by_name["a"].verified
    assert figures[0].content.startswith(b"\x89PNG")
    text = " ".join(registrations.conclusion(found))
    best = min("abcdfghjkl", key=lambda name: by_name[name].median_weight)
    assert f"methods {best} leaves the least residual" in text


def _row(method: str, weight: float, layers: int = 1, subregions: int = 1):
    return registrations.MethodRow(
        scene="s", method=method, layers=layers, subregions=subregions, verified=0.5,
        registered=1.0, median_weight=weight, rms_weight=weight, cpu_seconds=0.1, errors=None,
    )  # fmt: skip


def test_the_conclusion_follows_the_numbers():
    rows = [_row("a", 4.0), _row("c", 4.04), _row("f", 2.0), _row("j", 5.0, 11, 3)]
    text = registrations.conclusion(rows)[0]
    assert "eleven layers lower the residual by 50 %" in text
    assert "three strips change it by less than 2 %" in text
    assert "both together raise it by 25 %" in text


def test_a_picture_without_detail_explains_nothing_and_the_original_everything():
    random = np.random.default_rng(1)
    truth = random.uniform(0, 255, (90, 118))
    smooth = np.full_like(truth, truth.mean())
    same = spectra.beyond_nyquist("s", "m", truth, truth, (2, 2))
    assert (same.energy, same.true_energy) == pytest.approx((1, 1))
    assert spectra.beyond_nyquist("s", "m", smooth, truth, (2, 2)).true_energy == pytest.approx(0)
    invented = spectra.beyond_nyquist("s", "m", random.uniform(0, 255, truth.shape), truth, (2, 2))
    assert invented.energy == pytest.approx(1, abs=0.2)
    assert invented.true_energy < 0  # as much detail, and all of it wrong


def test_the_radial_average_finds_a_wave_where_it_is():
    rows, columns = np.mgrid[:96, :128]
    wave = 100 * np.cos(2 * math.pi * (0.30 * columns + 0.05 * rows))
    frequency, power = spectra.radial_average(wave)
    assert frequency[int(np.argmax(power))] == pytest.approx(math.hypot(0.30, 0.05), abs=0.011)


def test_the_curve_over_the_assumed_psf_is_highest_near_the_true_one(subject):
    curve, figure = sensitivity.measure_curve(
        subject, Degradation(psf_sigma=1.0), factors=(0.6, 1.0, 1.6), supports=(3, 7)
    )
    assert curve.psnr[1] > curve.psnr[0]
    assert curve.psnr[1] > curve.psnr[2]
    assert curve.psnr_of_supports[1] > curve.psnr_of_supports[0]
    assert curve.found.true_psnr == curve.psnr[1]
    assert curve.found.met
    assert curve.psnr[1] == _psnr_of_default(subject, Degradation(psf_sigma=1.0))
    assert figure.content.startswith(b"\x89PNG")


def _psnr_of_default(subject, degradation):
    eye = subject.eyes[0]
    run = subject.run("default", degradation, eye)
    return fidelity_of(run.image, subject.degraded(degradation).truth[eye], BORDER).psnr


def test_a_method_is_run_once_whoever_asks(subject):
    degradation, eye = Degradation(psf_sigma=1.0, noise_sigma=2.0), subject.eyes[0]
    first = subject.run("default", degradation, eye)
    assert subject.run("default", degradation, eye) is first
    assert subject.run("default", replace(degradation, seed=2), eye) is not first
    assert subject.run("bicubic", degradation, eye) is not first


def test_without_a_piece_something_is_lost(subject):
    found = ablations.measure_ablations(subject)
    by_name = {(row.group, row.name): row.psnr for row in found}
    whole = by_name[("piece", ablations.WHOLE)]
    assert by_name[("piece", "no weights, no verification")] < whole
    assert whole == _psnr_of_default(subject, ablations.DEGRADATION)
    assert by_name[("views", "1")] < by_name[("views", "2")] < by_name[("views", "3")]
    assert ("piece", "no calibration") not in by_name
    assert any("more views bring" in sentence for sentence in ablations.chapter(found, []).answer)


def test_what_is_clipped_is_not_asked_of_a_prediction(subject):
    """A strip of sky that flickers between black and white changes who is asked, not the answer."""
    frame = subject.sample.frame(0, psf_sigma=1.0, noise_sigma=1.0)
    stream = np.random.default_rng(1)
    views = []
    for view in frame.views:
        luma = view.luma.copy()
        luma[:12] = stream.choice([0.0, 255.0], size=luma[:12].shape)
        views.append(replace(view, luma=luma))
    burnt = replace(frame, views=tuple(views))
    plain, clipped = (
        left_out.measure_prediction(replace(subject, frame=filmed, sample=None))[0]
        for filmed in (frame, burnt)
    )
    assert clipped.pixels < plain.pixels - 0.1
    assert clipped.default > clipped.bicubic
    assert clipped.default == pytest.approx(plain.default, abs=1.0)


def test_too_small_a_scene_and_a_missing_frame_are_refused(tmp_path):
    manifest = write_scene(
        tmp_path / "small", SampleScene(width=40, height=30, num_views=2), num_frames=1
    )
    with pytest.raises(ConfigurationError, match=r"40×30 are too small"):
        open_subject(str(manifest), Settings())
    with pytest.raises(ConfigurationError, match="frame 7 is not within 0:1"):
        open_subject(str(manifest), Settings(), frame_number=7)
