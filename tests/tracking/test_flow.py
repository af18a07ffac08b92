"""Points followed from image to image: found where they are, or not at all."""

import cv2
import numpy as np
import pytest

from miniloop_cli.tracking.flow import BORDER_PX, CORNER_DISTANCE_PX, contrasts, follow, new_corners

HEIGHT, WIDTH = 120, 160
EVERYWHERE = np.ones((HEIGHT, WIDTH), bool)


@pytest.fixture(scope="module")
def pattern():
    """image(shift, seed): sums of waves of 6 to 100 px, exact at every place, moved by `shift` pixels."""
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))

    def image(shift=(0.0, 0.0), seed=0):
        rng, value = np.random.default_rng(seed), np.zeros((HEIGHT, WIDTH))
        for _ in range(80):
            length, angle, phase = 6 * (100 / 6) ** rng.random(), *rng.uniform(0, 2 * np.pi, 2)
            along = np.cos(angle) * (x - shift[0]) + np.sin(angle) * (y - shift[1])
            value += np.sqrt(length) * np.cos(2 * np.pi / length * along + phase)
        return np.clip(128 + 1.5 * value, 0, 255).astype(np.uint8)

    return image


def corners(image):
    px = new_corners(image, np.zeros((0, 2), np.float32), 60, EVERYWHERE)
    margin = 25
    return px[((px > margin) & (px < (WIDTH - margin, HEIGHT - margin))).all(axis=1)]


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.3, -0.4), (2.6, 1.7), (-6.2, 9.5)])
def test_a_shift_is_found_to_a_tenth_of_a_pixel(pattern, shift):
    before, after = pattern(), pattern(shift)
    px = corners(before)
    assert len(px) > 15
    near = px + np.float32(shift) + np.float32([1.5, -1.0])
    for guess_px, sure in ((near, True), (px, False)):
        found, good = follow(before, after, px, contrasts(before, px), guess_px, sure)
        assert good.mean() > 0.9
        assert np.abs(found - px - shift)[good].max() < 0.1


def test_points_whose_surroundings_were_replaced_are_dropped(pattern):
    before, after, middle = pattern(), pattern((1.0, 0.5)), np.array([80, 60])
    other = np.zeros((HEIGHT, WIDTH), np.uint8)
    cv2.circle(other, (80, 60), 32, (1,), -1)
    after = np.where(other > 0, pattern(seed=1), after)
    px = corners(before)
    away_px = np.linalg.norm(px - middle, axis=1)
    _, good = follow(before, after, px, contrasts(before, px), px, sure=True)
    assert (away_px < 22).sum() > 3 and not good[away_px < 22].any()
    assert (away_px > 44).sum() > 3 and good[away_px > 44].mean() > 0.8


def test_points_that_leave_the_image_are_dropped(pattern):
    before, after = pattern(), pattern((-20.0, 0.0))
    px = new_corners(before, np.zeros((0, 2), np.float32), 100, EVERYWHERE)
    found, good = follow(before, after, px, contrasts(before, px), px - np.float32([20, 0]), sure=True)
    assert not good[px[:, 0] < 20 + BORDER_PX - 1].any()
    assert (found[good] >= BORDER_PX).all()
    inner = ((px > (50, 15)) & (px < (WIDTH - 15, HEIGHT - 15))).all(axis=1)
    assert good[inner].mean() > 0.9


@pytest.mark.parametrize("noise", [6.0, 20.0])
def test_noise_is_not_followed(noise):
    """It has corners, and a third of them are found near their place in the next image, and back again."""
    rng = np.random.default_rng(0)
    before, after = np.clip(rng.normal(60, noise, (2, 240, 320)), 0, 255).astype(np.uint8)
    px = new_corners(before, np.zeros((0, 2), np.float32), 300, np.ones((240, 320), bool))
    assert len(px) > 200
    assert follow(before, after, px, contrasts(before, px), px, sure=True)[1].mean() < 0.01
    assert follow(before, after, px, np.full(len(px), np.inf, np.float32), px, sure=True)[1].mean() > 0.1


@pytest.mark.parametrize("gain", [0.9, 1.1])
def test_a_changed_exposure_is_followed(pattern, gain):
    before, after = pattern(), np.clip(gain * pattern((2.6, 1.7)).astype(float), 0, 255).astype(np.uint8)
    px = corners(before)
    _, good = follow(before, after, px, contrasts(before, px), px, sure=True)
    assert good.mean() > 0.9


def test_contrasts_are_deviations_of_the_windows(pattern):
    image, px = pattern(), np.float32([[40.2, 60.9], [100.0, 30.0]])
    by_hand = [image[y - 7 : y + 8, x - 7 : x + 8].std() for x, y in px.astype(int)]
    np.testing.assert_allclose(contrasts(image, px), by_hand, rtol=1e-3)


def test_no_points_are_followed_to_none(pattern):
    none = np.zeros((0, 2), np.float32)
    found, good = follow(pattern(), pattern(), none, np.zeros(0, np.float32), none, sure=True)
    assert found.shape == (0, 2) and good.shape == (0,)


def test_corners_keep_away_from_known_points_and_from_what_is_hidden(pattern):
    image = pattern()
    first = new_corners(image, np.zeros((0, 2), np.float32), 30, EVERYWHERE)
    assert len(first) == 30
    left = EVERYWHERE.copy()
    left[:, 80:] = False
    more = new_corners(image, first[:10], 200, left)
    assert (more[:, 0] < 80).all() and len(more) > 10
    away_px = np.linalg.norm(more[:, None] - first[None, :10], axis=2)
    assert away_px.min() > CORNER_DISTANCE_PX - 1
    assert len(new_corners(image, first, 0, EVERYWHERE)) == len(new_corners(image, first, 9, ~EVERYWHERE)) == 0
    assert len(new_corners(np.full_like(image, 9), first, 9, EVERYWHERE)) == 0
