"""The sample scene must be true: everything else is measured against it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from pipeline.degradation import Degradation, degrade_image
from pipeline.errors import ConfigurationError
from pipeline.grid import Grid, Sampling
from pipeline.media.source import open_scene
from pipeline.synthetic import SampleScene, raycast, stage, write_scene
from pipeline.synthetic.observation import blur_and_sample, degraded_depth, sampling_taps
from pipeline.synthetic.textures import PAINTERS, painted

WIDTH, HEIGHT = 160, 112
PHASES = list(Sampling)


@pytest.fixture(scope="module")
def scene() -> SampleScene:
    return SampleScene(width=WIDTH, height=HEIGHT, num_views=5)


def panel(depth: float, half_width: float, half_height: float, x: float = 0.0) -> stage.Body:
    """A grey panel that faces the cameras, lit evenly."""
    return stage.Body(
        texture="plain", kind=raycast.RECTANGLE, size=(half_width, half_height, 0.0), glow=1.0,
        group=round(100 * depth), pose=stage.fixed(np.eye(3), x, -1.0, depth),
    )  # fmt: skip


@pytest.fixture(scope="module")
def two_panels() -> SampleScene:
    """A wall at 6 m and a panel at 3 m before its middle, without rotations."""
    bodies = (panel(6.0, 20.0, 20.0), panel(3.0, 0.3, 0.2))
    return SampleScene(
        width=96, height=72, num_views=2, rotation_degrees=0.0, max_disparity=12.0, bodies=bodies
    )


def interpolated(field: np.ndarray, position: np.ndarray, order: int) -> np.ndarray:
    return map_coordinates(field, [position[..., 1], position[..., 0]], order=order, mode="mirror")


# --- frames ------------------------------------------------------------------------------


def test_a_frame_has_the_promised_shapes(scene):
    frame = scene.frame(0, color=True, depth="stereo", calibration=True)
    assert [view.view_id for view in frame.views] == ["cam0", "cam1", "cam2", "cam3", "cam4"]
    assert (frame.left, frame.right) == ("cam2", "cam3")
    assert frame.depth_is_metric
    for view in frame.views:
        assert view.luma.shape == view.depth_map.shape == (HEIGHT, WIDTH)
        assert view.chroma.shape == (HEIGHT, WIDTH, 2)
    assert scene.render_hr(0).shape == (2 * HEIGHT, 2 * WIDTH, 3)


def test_magnification_may_differ_along_x_and_y():
    scene = SampleScene(width=48, height=40, num_views=2, magnification=3, magnification_y=1)
    assert scene.render_hr(1).shape == (40, 144, 3)
    frame = scene.frame(0, sampling=Sampling.AREA, calibration=True)
    assert frame.lr_shape == (40, 48)
    square = SampleScene(width=48, height=40, num_views=2, magnification=3)
    for number, view in enumerate(frame.views):
        other = square.calibration(number, Sampling.AREA)
        np.testing.assert_allclose(view.calibration.intrinsics, other.intrinsics, atol=1e-9)


def test_a_single_camera_looks_at_the_stage():
    picture = SampleScene(width=48, height=36, num_views=1).render_hr(0)
    assert picture.mean() > 40
    assert picture.std() > 10


def test_the_same_seed_gives_the_same_frame_and_another_seed_another():
    small = {"width": 48, "height": 36, "num_views": 2}
    first, again, other = (SampleScene(**small, seed=seed) for seed in (3, 3, 4))
    options = {"noise_sigma": 2.0, "depth": "stereo", "color": True}
    frames = [scene.frame(5, **options) for scene in (first, again, other)]
    for one, two in zip(frames[0].views, frames[1].views, strict=True):
        np.testing.assert_array_equal(one.luma, two.luma)
        np.testing.assert_array_equal(one.chroma, two.chroma)
        np.testing.assert_array_equal(one.depth_map, two.depth_map)
    assert np.abs(frames[0].views[0].luma - frames[2].views[0].luma).mean() > 2
    noisier = first.frame(5, **options, noise_seed=2)
    assert (noisier.views[0].luma != frames[0].views[0].luma).mean() > 0.5


def test_grey_observation_is_that_of_set_1(scene):
    luma = cv2.cvtColor(scene.render_hr(1), cv2.COLOR_RGB2GRAY)
    degradation = Degradation(psf_sigma=1.3, psf_support=7, noise_sigma=2.0, seed=9)
    expected = degrade_image(luma, degradation, np.random.default_rng([9, 0, 1]))
    frame = scene.frame(0, psf_sigma=1.3, psf_support=7, noise_sigma=2.0, noise_seed=9)
    np.testing.assert_array_equal(frame.views[1].luma, expected)


@pytest.mark.parametrize("color", [False, True])
def test_noise_has_the_sigma_asked_for(scene, color):
    clean, noisy = (
        scene.frame(0, noise_sigma=sigma, depth=None, color=color).views[3].luma
        for sigma in (0.0, 3.0)
    )
    inside = (clean > 15) & (clean < 240)
    # both are rounded: two twelfths of a grey level squared
    measured = np.sqrt((noisy - clean)[inside].var() - 2 / 12)
    assert measured == pytest.approx(3.0, rel=0.03)


def test_a_constant_surface_stays_constant(two_panels):
    for phase in PHASES:
        frame = two_panels.frame(0, sampling=phase)
        assert [np.unique(view.luma).tolist() for view in frame.views] == [[128], [128]]


def test_sizes_that_make_no_sense_are_refused():
    with pytest.raises(ConfigurationError):
        SampleScene(width=0)
    with pytest.raises(ConfigurationError):
        SampleScene(magnification=0)
    with pytest.raises(ConfigurationError, match="sonar"):
        SampleScene(width=16, height=12, num_views=1).frame(0, depth="sonar")


# --- sampling phases ---------------------------------------------------------------------


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("magnification", [1, 2, 3, 4])
def test_a_ramp_is_observed_where_the_grid_says(phase, magnification):
    grid = Grid(magnification_x=magnification, magnification_y=2, sampling=phase)
    height, width = grid.hr_shape((18, 22))
    x, y = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    seen = blur_and_sample(3 * x + 5 * y, grid, psf_sigma=1.2, psf_support=5)
    column, row = np.meshgrid(np.arange(22), np.arange(18))
    expected = 3 * (magnification * column + grid.offset_x) + 5 * (2 * row + grid.offset_y)
    np.testing.assert_allclose(seen[4:-4, 4:-4], expected[4:-4, 4:-4], atol=1e-9)


@pytest.mark.parametrize("phase", [0.0, 0.25, 0.5, 0.75])
def test_taps_sum_to_one_and_stay_inside_their_support(phase):
    first, taps = sampling_taps(1.7, 7, phase)
    offsets = first + np.arange(taps.size) - phase
    assert taps.sum() == pytest.approx(1)
    assert np.abs(offsets).max() <= 3.5
    if phase in (0.0, 0.5):
        np.testing.assert_allclose(taps, taps[::-1])


def test_calibrations_of_both_phases_mean_the_same_camera(scene):
    point = np.array([0.3, -0.7, 3.4, 1.0])
    seen = {}
    for phase in PHASES:
        x, y, z = scene.calibration(4, phase).projection @ point
        grid = scene.grid(phase)
        seen[phase] = (2 * x / z + grid.offset_x, 2 * y / z + grid.offset_y, z)
    np.testing.assert_allclose(seen[Sampling.AREA], seen[Sampling.DECIMATION], atol=1e-9)


# --- truth -------------------------------------------------------------------------------


@pytest.mark.parametrize("phase", PHASES)
def test_depth_and_calibration_give_the_true_motion(scene, phase):
    truth = scene.truth(4, sampling=phase)
    motion = truth.motion(4, 2)
    source, reference = truth.calibration[4], truth.calibration[2]
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.linalg.inv(source.intrinsics) @ np.stack((x, y, np.ones_like(x))).reshape(3, -1)
    points = rays * truth.depth[4].ravel()
    rotation, shift = source.world_to_camera[:3, :3], source.world_to_camera[:3, 3:]
    world = rotation.T @ (points - shift)
    landing = reference.projection @ np.vstack((world, np.ones(world.shape[1])))
    expected = (landing[:2] / landing[2]).T.reshape(HEIGHT, WIDTH, 2)
    np.testing.assert_allclose(motion.position, expected, atol=1e-7)
    np.testing.assert_allclose(truth.nearness[4], 1 / truth.depth[4])


@pytest.mark.parametrize("phase", PHASES)
def test_there_and_back_is_where_it_began(scene, phase):
    there = scene.true_motion(0, 2, sampling=phase)
    back = scene.true_motion(2, 0, sampling=phase)
    returned = np.stack(
        [interpolated(back.displacement[..., axis], there.position, 1) for axis in range(2)], -1
    )
    known = (
        there.visible
        & ~there.near_edge
        & (interpolated(back.visible * 1.0, there.position, 1) > 0.999)
    )
    assert known.mean() > 0.5
    error = np.linalg.norm(there.displacement + returned, axis=-1)[known]
    assert np.percentile(error, 99) < 0.02  # a curved field, interpolated linearly


def test_a_view_does_not_move_against_itself(scene):
    motion = scene.true_motion(3, 3)
    np.testing.assert_allclose(motion.displacement, 0, atol=1e-9)
    assert motion.visible[1:-1, 1:-1].all()


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("source", [0, 1, 4])
def test_pictures_warped_by_the_true_motion_agree(scene, phase, source):
    grid = scene.grid(phase)
    luma = [cv2.cvtColor(scene.render_hr(view), cv2.COLOR_RGB2GRAY) for view in (source, 2)]
    seen, reference = (blur_and_sample(image, grid, 1.7, 9) for image in luma)
    motion = scene.true_motion(source, 2, sampling=phase, psf_support=9)
    warped = interpolated(reference, motion.position, 3)
    known = motion.visible & ~motion.near_edge
    assert known.mean() > 0.5
    residual = (warped - seen)[known]
    assert np.median(np.abs(residual)) < 0.3
    # a wrong position would leave a trace of the gradient
    gradient = np.stack([part[known] for part in np.gradient(seen)], axis=-1)
    shift = np.linalg.lstsq(gradient, residual, rcond=None)[0]
    assert np.abs(shift).max() < 0.01


def test_visibility_of_a_panel_before_a_wall(two_panels):
    source, reference = two_panels.cameras
    motion = two_panels.true_motion(1, 0)
    depth = two_panels.true_depth(1)
    nearer = depth.min()
    on_panel = depth < (nearer + depth.max()) / 2
    assert on_panel.any()
    assert motion.visible[on_panel].all()
    # by hand: the wall is hidden where the line to the reference camera passes the panel
    height, width = depth.shape
    x, y = np.meshgrid(2.0 * np.arange(width), 2.0 * np.arange(height))
    points = source.back_project(x, y, depth)
    share = (3.0 - reference.centre[2]) / (points[..., 2] - reference.centre[2])
    passing = reference.centre + (points - reference.centre) * share[..., None]
    behind = ~on_panel & (np.abs(passing[..., 0]) <= 0.3) & (np.abs(passing[..., 1] + 1.0) <= 0.2)
    assert 20 < behind.sum() < 2000
    inside = (motion.position >= 0).all(-1) & (motion.position <= (width - 1, height - 1)).all(-1)
    np.testing.assert_array_equal(motion.visible, inside & ~behind)
    assert not inside.all()


def test_edges_are_flagged_as_far_as_the_psf_reaches(two_panels):
    motion = two_panels.true_motion(1, 1, psf_support=7)
    on_panel = two_panels.surfaces(1) == 1
    assert not motion.near_edge[on_panel].all()
    near = cv2.dilate(on_panel.astype(np.uint8), np.ones((3, 3))) != cv2.erode(
        on_panel.astype(np.uint8), np.ones((3, 3))
    )
    far = cv2.dilate(on_panel.astype(np.uint8), np.ones((9, 9))) == cv2.erode(
        on_panel.astype(np.uint8), np.ones((9, 9))
    )
    assert motion.near_edge[near].all()
    assert not motion.near_edge[far].any()


@pytest.mark.parametrize(("views", "wanted"), [(8, 80.0), (8, 12.0), (3, 25.0)])
def test_the_largest_disparity_is_the_one_asked_for(views, wanted):
    scene = SampleScene(width=256, height=192, num_views=views, max_disparity=wanted)
    left = scene.reference_views[0]
    motion = scene.true_motion(left, views - 1)
    assert np.abs(motion.displacement[..., 0]).max() == pytest.approx(wanted, rel=0.03)
    for view in (0, views - 1):
        assert (scene.surfaces(view) >= 0).all()  # no view looks past the stage
    centres = [camera.centre[0] for camera in scene.cameras]
    assert centres == sorted(centres)


@pytest.mark.parametrize("degrees", [0.0, 2.0])
def test_no_view_is_turned_more_than_asked_for(degrees):
    scene = SampleScene(width=64, height=48, rotation_degrees=degrees)
    angles = [
        np.degrees(
            np.linalg.norm(cv2.Rodrigues(one.rotation @ scene.cameras[number].rotation.T)[0])
        )
        for one in scene.cameras
        for number in scene.reference_views
    ]
    assert max(angles) == pytest.approx(degrees, abs=0.02)


# --- movement ----------------------------------------------------------------------------


def test_painting_what_moves_equals_painting_everything(scene):
    renderer = scene._renderer
    for view, time in ((0, 0.25), (4, 1.5)):
        whole = np.zeros((2 * HEIGHT, 2 * WIDTH, 3), np.uint8)
        renderer.paint(view, time, np.ones(whole.shape[:2], np.uint8), whole)
        np.testing.assert_array_equal(scene.render_hr(view, time), whole)
        assert renderer.touched(view, time).mean() < 0.5


def test_something_moves_and_the_rest_stands_still(scene):
    first, later = (scene.render_hr(2, time).astype(int) for time in (0.0, 1.0))
    changed = np.abs(first - later).max(axis=-1) > 8
    assert 0.03 < changed.mean() < 0.35
    depth = [scene.true_depth(2, index) for index in (0, 12)]
    assert (depth[0] == depth[1]).mean() > 0.6
    assert (depth[0] != depth[1]).mean() > 0.05


# --- depth as delivered ------------------------------------------------------------------


def test_stereo_depth_is_nearly_true_and_has_holes(scene):
    stored, exact = scene.stereo_depth(0).astype(float), scene.exact_depth(0).astype(float)
    unknown = stored == 0
    assert 0.01 < unknown.mean() < 0.25
    hidden = ~scene.true_motion(0, 1).visible
    assert unknown[hidden].mean() > 0.5 > 5 * unknown[~hidden].mean()
    error = np.abs(stored - exact)
    assert 0.5 < np.median(error[~unknown]) < 3
    near_edge = scene.true_motion(0, 0).near_edge
    wrong = (error > 12) & ~unknown
    assert wrong[near_edge].mean() > 3 * wrong[~near_edge].mean()
    assert wrong.mean() > 0.005
    scale, offset = scene.depth_scale
    np.testing.assert_allclose(exact * scale + offset, 1 / scene.true_depth(0), atol=0.51 * scale)


def test_depth_of_a_plane_is_only_noisy():
    plane = np.full((60, 80), 0.25)
    stored = degraded_depth(
        plane, np.zeros(plane.shape, bool), (0.1, 0.5), np.random.default_rng(1), noise_levels=2.0
    )
    assert stored.dtype == np.uint8
    levels = stored[stored > 0].astype(float)
    assert levels.std() == pytest.approx(2.0, rel=0.3)
    assert levels.mean() == pytest.approx(1 + 0.15 / 0.4 * 254, abs=1)


# --- surfaces and files ------------------------------------------------------------------


def test_every_surface_has_a_painter_and_something_to_see():
    assert {body.texture.rstrip("0123456789") for body in stage.STAGE} <= set(PAINTERS)
    for body in stage.STAGE:
        picture = painted(body.texture, body.texture_extent, 60.0, 0)
        assert picture.dtype == np.uint8
        assert picture.shape[2] == 3
        assert cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY).std() > 4, body.texture


def test_the_picture_has_the_spectrum_of_a_photograph():
    luma = cv2.cvtColor(SampleScene().render_hr(3), cv2.COLOR_RGB2GRAY).astype(float)
    luma = luma[:768, :768] * np.outer(np.hanning(768), np.hanning(768))
    power = np.abs(np.fft.fft2(luma - luma.mean())) ** 2
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(768), np.fft.fftfreq(768)))
    places = np.array([0.02, 0.04, 0.08, 0.16, 0.32])
    energy = [power[(frequency >= f) & (frequency < 1.2 * f)].mean() for f in places]
    slope = np.polyfit(np.log(places), np.log(energy), 1)[0]
    assert -2.8 < slope < -1.6  # of power; amplitude falls as one over frequency


@pytest.mark.parametrize("color", [False, True])
def test_what_is_written_reads_back_as_the_frame(tmp_path, scene, color):
    options = {"noise_sigma": 1.0, "depth": "stereo", "calibration": True, "color": color}
    options["sampling"] = Sampling.AREA
    path = write_scene(tmp_path / "sample", scene, num_frames=2, truth=True, **options)
    assert path.name == "scene.json"
    expected = scene.frame(1, **options)
    with open_scene(path) as source:
        assert len(source.info.frame_indices) == 2
        frame = source.read(1)
    assert (frame.left, frame.right) == (expected.left, expected.right)
    for read, made in zip(frame.views, expected.views, strict=True):
        np.testing.assert_array_equal(read.luma, made.luma)
        np.testing.assert_allclose(read.depth_map, made.depth_map, rtol=1e-5)
        np.testing.assert_allclose(read.calibration.projection, made.calibration.projection)
    truth = cv2.imread(str(tmp_path / "sample" / "truth" / "cam2-000001.png"), cv2.IMREAD_UNCHANGED)
    assert truth.shape[:2] == (2 * HEIGHT, 2 * WIDTH)
