"""An imported network: what it is fed, how its answer is read, and that no change is no slope."""

import numpy as np
import pytest

from gelform.slopes.color_models._shared.layers import Layers
from gelform.slopes.color_models.network import NetworkModel

SHAPE = (6, 8)
BACKGROUND = np.random.default_rng(0).uniform(60, 160, (*SHAPE, 3)).astype(np.float32)


def linear(weight):
    """A network of one layer: its outputs are weight @ inputs."""
    return Layers((np.asarray(weight, dtype=np.float32),), (np.zeros(2, dtype=np.float32),))


def model(weight, position="xy", answer="angles"):
    return NetworkModel(linear(weight), BACKGROUND, position, answer)


def gradients(one, change):
    return one.prepare(BACKGROUND, SHAPE).gradients_from_color(change.astype(np.float32))[0]


@pytest.mark.parametrize(("position", "place"), [("xy", (1, 2)), ("yx", (2, 1)), ("zeros", (0, 0))])
def test_it_is_fed_blue_green_red_and_the_place(position, place):
    """Its answer, read as an angle, worked out from image and place."""
    weight = np.array([[0.3, 0.5, -0.4, 0.6, -0.7], [0.2, -0.3, 0.1, 0.4, 0.5]])
    change = np.random.default_rng(6).uniform(-0.2, 0.2, (*SHAPE, 3))
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    both = [np.zeros(SHAPE), x / SHAPE[1], y / SHAPE[0]]
    fed = [*np.moveaxis(BACKGROUND[..., ::-1] / 255, -1, 0), *(both[k] for k in place)]
    rest, touched = np.stack(fed, axis=-1), np.stack(fed, axis=-1)
    touched[..., :3] += change[..., ::-1]
    expected = -np.tan(touched @ weight.T) + np.tan(rest @ weight.T)
    np.testing.assert_allclose(gradients(model(weight, position), change), expected, atol=1e-5)


def test_angles_go_down_where_pressed_and_normals_point_along_them():
    change = np.full((*SHAPE, 3), 0.1)
    weight = np.zeros((2, 5))
    weight[0, 0] = 0.5
    rest = 0.5 * BACKGROUND[..., 2] / 255
    angles = -np.tan(rest + 0.05) + np.tan(rest)
    np.testing.assert_allclose(gradients(model(weight), change)[..., 0], angles, atol=1e-5)

    def slope(n):
        return -n / np.sqrt(1 - n**2)

    found = gradients(model(weight, answer="normals"), change)[..., 0]
    np.testing.assert_allclose(found, slope(rest + 0.05) - slope(rest), atol=1e-5)


@pytest.mark.parametrize(("position", "answer"), [("xy", "angles"), ("yx", "normals"), ("zeros", "angles")])
def test_scattered_pixels_and_the_file_of_it_answer_as_the_frame_does(position, answer):
    one = model(np.random.default_rng(2).normal(0, 0.3, (2, 5)), position, answer)
    change = np.random.default_rng(3).normal(0, 0.1, (*SHAPE, 3)).astype(np.float32)
    rows, columns = np.array([0, 2, 5]), np.array([7, 1, 3])
    found = one.gradients_at(change[rows, columns], columns, rows)
    np.testing.assert_allclose(found, gradients(one, change)[rows, columns], atol=1e-6)
    again = NetworkModel.from_arrays(*one.to_arrays())
    np.testing.assert_array_equal(gradients(one, change), gradients(again, change))


def test_what_it_is_not_is_refused():
    three = Layers((np.zeros((2, 3), dtype=np.float32),), (np.zeros(2, dtype=np.float32),))
    with pytest.raises(ValueError, match="5 inputs and 2 outputs, got 3 and 2"):
        NetworkModel(three, BACKGROUND, "xy", "angles")
    with pytest.raises(ValueError, match="Expected position"):
        model(np.zeros((2, 5)), "there")
    with pytest.raises(ValueError, match="6x8"):
        model(np.zeros((2, 5))).prepare(np.zeros((4, 4, 3)), (4, 4))
