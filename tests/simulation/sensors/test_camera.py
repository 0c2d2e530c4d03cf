from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np

from offpiste.logs.ground_truth import GROUND_KINDS
from offpiste.simulation.rendering.appearance import make_appearance
from offpiste.simulation.rendering.scene import SURFACES, world_scene
from offpiste.simulation.rendering.shading import FINE, GLOSS, HIGH, LOW
from offpiste.simulation.sample import Pose
from offpiste.simulation.sensors import camera as of_camera
from offpiste.simulation.sensors.camera import MODEL, Camera, CameraSettings, pixel_rays, project_points, render
from offpiste.simulation.sensors.lidar import Lidar, LidarSettings
from offpiste.simulation.sensors.suite import mounted
from simulation import scenes

SETTINGS = CameraSettings("camera", mounted((0.60, 0.0, 1.54), pitch=17.0, optical=True))
GROUND, BODY = SURFACES.index("ground"), SURFACES.index("body")


def _pose(x=0.0, y=0.0, z=0.36, yaw=0.0):
    return Pose(np.array([x, y, z]), np.array([0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)]))


def _in_camera(pose, points):
    """Return points of the world in the camera's frame."""
    mount = SETTINGS.body_from_sensor
    return ((points - pose.position) @ pose.rotation - mount.position) @ mount.rotation


def test_rays_go_through_the_pixels_that_the_recorded_calibration_says():
    rays = pixel_rays(MODEL)
    pixels, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), MODEL.matrix, np.array(MODEL.distortion))
    u, v = np.meshgrid(np.arange(MODEL.width), np.arange(MODEL.height))
    np.testing.assert_allclose(pixels[:, 0], np.stack((u, v), axis=-1).reshape(-1, 2), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0)


def test_borders_of_colour_are_found_where_the_calibration_projects_them():
    # Stripes 2 m wide across and along: borders at every odd metre, half-way between nodes 0.5 m apart.
    dark, bright = GROUND_KINDS.index("mud"), GROUND_KINDS.index("loose_sand")

    def kind(x, y):
        return np.where((np.floor((x + 1.25) / 2) + np.floor((y + 1.25) / 2)) % 2 == 0, dark, bright)

    world = scenes.world(size=40, resolution=0.5, kind=kind, slope=(0.03, -0.02))
    world = replace(world, settings=replace(world.settings, appearance_noise=0.0))
    pose = _pose(z=0.4, yaw=0.1)
    scene = world_scene(world)
    look = make_appearance(world, scene, 0)
    plain = look.ground.nodes.copy()
    plain[..., HIGH : HIGH + 3], plain[..., FINE : GLOSS + 1] = plain[..., LOW : LOW + 3], 0
    # Colours without texture, and borders that are not displaced by noise.
    flat = np.zeros_like(look.ground.lattice)
    look = replace(look, ground=look.ground._replace(nodes=plain, lattice=flat))
    image = render(scene, look, Camera(SETTINGS), pose, 0).astype(float).sum(axis=2)

    # Along lines across a border, from 0.9 m before it to 0.9 m behind: brightness against the step's place.
    errors = []
    along = np.linspace(-0.9, 0.9, 181)
    for x, y in [(x, y) for x in (3.75, 5.75, 7.75) for y in (-2.25, -0.25, 1.75)]:
        points = np.column_stack((x + along - 1.0, np.full(181, y), 0.03 * (x + along - 1.0) - 0.02 * y))
        pixels, seen = project_points(_in_camera(pose, points), MODEL)
        if not seen.all():
            continue
        values = cv2.remap(
            image.astype(np.float32), pixels[:, :1].astype(np.float32), pixels[:, 1:].astype(np.float32), 1
        )
        values = values[:, 0]
        halves = values[:40].mean(), values[-40:].mean()
        assert abs(halves[0] - halves[1]) > 60
        # The border is the middle of the step: its first moment.
        share = np.clip((values - halves[0]) / (halves[1] - halves[0]), -0.5, 1.5)
        found = 0.9 - np.trapezoid(share, along)
        metres_per_pixel = 1.8 / np.linalg.norm(pixels[-1] - pixels[0])
        errors.append(found / metres_per_pixel)
    assert len(errors) >= 6
    assert np.max(np.abs(errors)) < 1.0


def test_a_world_may_have_any_order_in_memory():
    world = scenes.world(slope=(0.05, 0.02))
    model = replace(MODEL, width=31, height=17, matrix=np.array([[20.0, 0.0, 15.0], [0.0, 20.0, 8.0], [0.0, 0.0, 1.0]]))
    camera = Camera(replace(SETTINGS, model=model))
    images = []
    for of in (world, replace(world, elevation=np.asfortranarray(world.elevation))):
        scene = world_scene(of)
        images.append(render(scene, make_appearance(of, scene, 0), camera, _pose(), 0))
    np.testing.assert_array_equal(*images)


def test_lidar_points_land_on_what_the_camera_sees_there():
    world = scenes.world(trees=scenes.tree(9.0, 1.0), bushes=scenes.bush(6.0, -2.0), slope=(0.05, 0.02))
    scene, pose = world_scene(world), _pose(z=0.5)
    lidar = LidarSettings("lidar", mounted((0.0, 0.0, 1.95)), rings=48, columns=1024, range_noise=0.0)
    scan = Lidar(lidar).scan(scene, scenes.motionless(pose), 0.0, np.random.default_rng(0))
    camera = Camera(SETTINGS)
    rays = camera.rays @ pose.rotation.T.astype(np.float32)
    hits = scene.cast(pose.apply(camera.origin[None]), rays, camera.own)
    surface, distance = camera.in_rows(hits.surface), camera.in_rows(hits.distance)

    in_camera = _in_camera(pose, pose.apply(lidar.body_from_sensor.apply(scan.points.astype(float))))
    pixels, seen = project_points(in_camera, MODEL)
    u, v = np.rint(pixels[seen]).astype(int).T
    # Away from edges: all pixels around see the same surface.
    around = [surface[np.clip(v + j, 0, 593), np.clip(u + i, 0, 959)] for j in (-3, 0, 3) for i in (-3, 0, 3)]
    clear = (np.array(around) == around[4]).all(axis=0)
    same = scan.surface[seen][clear] == around[4][clear]
    assert clear.sum() > 3000
    assert same.mean() > 0.99  # the rest: seen over an edge by the one, behind it by the other
    of_ground = clear & (scan.surface[seen] == GROUND) & (around[4] == GROUND)
    far = np.linalg.norm(in_camera[seen], axis=1)
    np.testing.assert_allclose(far[of_ground], distance[v, u][of_ground], rtol=0.01)


def test_development_darkens_corners_and_adds_noise_that_depends_on_the_pixel_alone():
    height, width, well, read = 90, 301, 8000.0, 0.002
    light = np.full((height, width, 3), 0.5, np.float32)
    light[0, :4, 0] = np.nan, np.inf, -np.inf, -1.0
    gain, curve = np.ones(3 * width, np.float32), (np.arange(4096) // 16).astype(np.uint8)

    def developed(vignetting, *cuts):
        image = np.zeros((height, width, 3), np.uint8)
        for first, last in pairwise(cuts):
            of_camera._develop(first, last, height, width, light, gain, vignetting, well, read, curve, 7, image)
        return image

    image = developed(0.0, 0, height)
    np.testing.assert_array_equal(image[0, :4, 0], [0, 255, 0, 0])
    # EMVA 1288: the variance of shot noise grows with brightness.
    brightness = image[1:] * (16 / 2047.5)
    assert abs(brightness.mean() - 0.5 + 8 / 2047.5) < 1e-3
    rounding = (16 / 2047.5) ** 2 / 12
    assert abs(brightness.std() / np.sqrt(0.5 / well + read**2 + rounding) - 1) < 0.03
    np.testing.assert_array_equal(image, developed(0.0, 0, 17, 60, height))
    darker = developed(0.25, 0, height)[1:] * 16.0
    assert abs(darker[-3:, -3:].mean() / darker[44:47, 149:152].mean() - 0.75) < 0.03
