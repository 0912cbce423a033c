import numpy as np
from edit3r_training.procedural_scenes import (
    BOX,
    CYLINDER,
    ELLIPSOID,
    LEVELS,
    ROOM,
    TILE,
    ProceduralScene,
    look_at,
)
from edit3r_training.raycaster import cast

K = np.array([[1.0, 0, 0.5], [0, 1.0, 0.5], [0, 0, 1]])


def _scene(*objects) -> ProceduralScene:
    """A room of half side 10 and objects given as (kind, centre, half extents); textures are plain
    grey.
    """
    rows = [(ROOM, (0, 0, 0), (10, 10, 10)), *objects]
    count = len(rows)
    return ProceduralScene(
        kinds=np.array([row[0] for row in rows]),
        centres=np.array([row[1] for row in rows], float),
        world_to_local=np.stack([np.diag(1 / np.array(row[2], float)) for row in rows]),
        textures=np.zeros((count, 6), np.int64),
        repeats=np.ones(count),
        tints=np.ones((count, 6, 3)),
        light=np.array([0.0, -1, 0]),
        ambient=1.0,
    )


def _cast(scene: ProceduralScene, size: int = 33):
    bank = np.full((1, LEVELS, TILE, TILE, 3), 128, np.uint8)
    return cast(
        scene, bank, look_at(np.array([0.0, 0, -3]), np.zeros(3)), K, (size, size)
    )


def test_depth_is_camera_z_of_the_nearest_surface():
    image = _cast(_scene((ELLIPSOID, (0, 0, 0), (1, 1, 1))))
    assert abs(image.depth[16, 16] - 2) < 1e-5
    # the far wall, z and not the length of the ray
    assert abs(image.depth[0, 0] - 13) < 1e-5


def test_box_and_cylinder_fronts_are_where_they_should_be():
    assert abs(_cast(_scene((BOX, (0, 0, 0), (1, 1, 0.5)))).depth[16, 16] - 2.5) < 1e-5
    assert (
        abs(_cast(_scene((CYLINDER, (0, 0, 0), (1, 1, 0.5)))).depth[16, 16] - 2.5)
        < 1e-5
    )


def test_nearer_objects_hide_farther_ones():
    image = _cast(
        _scene((BOX, (0, 0, 0), (1, 1, 1)), (ELLIPSOID, (0, 0, -1.5), (0.2, 0.2, 0.2)))
    )
    assert (image.objects[:, 16, 16] == 2).all()


def test_coverage_is_the_share_of_each_pixel():
    coverage = _cast(_scene((ELLIPSOID, (0, 0, 0), (1, 1, 1)))).coverage(2)
    assert np.allclose(coverage.sum(0), 1)
    assert coverage[1, 16, 16] == 1 and coverage[1, 0, 0] == 0
    assert ((coverage[1] > 0) & (coverage[1] < 1)).any()


def test_plain_texture_under_full_ambient_light_is_shown_as_it_is():
    assert np.allclose(_cast(_scene()).image, 128 / 255, atol=1e-6)
