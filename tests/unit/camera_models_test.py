"""Every camera model against a second implementation, written from the publications, on 100000 points each."""

import json
import subprocess

import numpy as np
import pytest


def brown(x, y, k1, k2, p1, p2, k3=0.0, k4=0.0, k5=0.0, k6=0.0):
    r = np.hypot(x, y)
    factor = (1 + k1 * r**2 + k2 * r**4 + k3 * r**6) / (1 + k4 * r**2 + k5 * r**4 + k6 * r**6)
    return factor * x + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2), factor * y + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y


# Each maps unit bearings to the normalised plane by its formula, wherever they are.
def pinhole(b, *distortion):
    x, y = b[:, 0] / b[:, 2], b[:, 1] / b[:, 2]
    return brown(x, y, *distortion) if distortion else (x, y)


def mei(b, xi, *distortion):
    return brown(b[:, 0] / (b[:, 2] + xi), b[:, 1] / (b[:, 2] + xi), *distortion)


def equidistant(b, k1, k2, k3, k4):
    theta, azimuth = np.arccos(np.clip(b[:, 2], -1, 1)), np.arctan2(b[:, 1], b[:, 0])
    r = np.polyval([k4, 0, k3, 0, k2, 0, k1, 0, 1, 0], theta)
    return r * np.cos(azimuth), r * np.sin(azimuth)


def double_sphere(b, xi, alpha):
    shifted = b + [0, 0, xi]
    scale = alpha * np.linalg.norm(shifted, axis=1) + (1 - alpha) * shifted[:, 2]
    return b[:, 0] / scale, b[:, 1] / scale


def eucm(b, alpha, beta):
    scale = alpha * np.sqrt(beta * (b[:, 0]**2 + b[:, 1]**2) + b[:, 2]**2) + (1 - alpha) * b[:, 2]
    return b[:, 0] / scale, b[:, 1] / scale


CAMERAS = [
    (pinhole, "rectified", (1242, 375), (721.5, 718.2, 609.6, 172.9), ()),
    (pinhole, "plumb_bob", (1242, 375), (721.5, 718.2, 609.6, 172.9), (-0.28, 0.09, 1.2e-3, -7e-4, -0.01)),
    (pinhole, "plumb_bob", (1600, 1600), (300, 300, 800, 800), (-0.3, 0.05, 0.03, -0.05)),
    (pinhole, "rational_polynomial", (1280, 720), (610, 611, 640.5, 366),
     (0.62, -2.7, 8e-4, -3e-4, 1.6, 0.5, -2.5, 1.5)),
    (pinhole, "rational_polynomial", (1600, 1600), (300, 300, 800, 800), (0, 0, 0, 0, 0, -0.5, 0, 0)),
    (equidistant, "equidistant", (1280, 960), (330, 331, 641, 478), (0.02, -0.006, 0.001, -0.0004)),
    (equidistant, "equidistant", (1600, 1600), (300, 300, 800, 800), (-0.1, 0, 0, 0)),
    (double_sphere, "double_sphere", (1280, 960), (300, 301, 640, 480), (-0.2, 0.6)),
    (double_sphere, "double_sphere", (1600, 1600), (300, 300, 800, 800), (-0.9, 0.2)),
    (eucm, "eucm", (1280, 960), (380, 379, 640, 480), (0.63, 1.05)),
    (eucm, "eucm", (1600, 1600), (200, 200, 800, 800), (0.4, 2.0)),
    (mei, "mei", (1400, 1400), (1336, 1335.5, 717, 706), (2.21, 0.017, 1.66, 1.2e-4, 4e-4)),  # as KITTI-360's
    (mei, "mei", (1600, 1600), (300, 300, 800, 800), (0.8, -0.2, 0.01, 0.02, -0.01)),
]


def bearings(angle, azimuth):
    return np.stack([np.sin(angle) * np.cos(azimuth), np.sin(angle) * np.sin(azimuth), np.cos(angle)], axis=-1)


def fold(formula, distortion):
    """The angle at which neighbours change sides: where the formula's Jacobian in angle and azimuth turns over."""
    angle, azimuth = np.meshgrid(np.arange(1e-3, np.pi, 5e-4), np.linspace(0, 2 * np.pi, 181), indexing="ij")
    h = 1e-6

    def at(a, z):
        return np.stack(formula(bearings(a.ravel(), z.ravel()), *distortion)).reshape(2, *a.shape)

    with np.errstate(all="ignore"):
        by_angle = at(angle + h, azimuth) - at(angle - h, azimuth)
        by_azimuth = at(angle, azimuth + h) - at(angle, azimuth - h)
        upright = by_angle[0] * by_azimuth[1] - by_angle[1] * by_azimuth[0] > 0
        # A pole, too, is the end: from one sample to the next the image jumps to the other side of the centre.
        image = at(angle, azimuth)
        upright[1:] &= np.sum(image[:, 1:] * image[:, :-1], axis=0) > 0
    return np.where(upright.all(axis=1), np.inf, angle[:, 0]).min()


def points():
    """Half around the camera, half before it; from 0.1 to 100 m."""
    rng = np.random.default_rng(7)
    around = rng.normal(size=(50_000, 3))
    ahead = bearings(rng.uniform(0, 1, 50_000), rng.uniform(0, 2 * np.pi, 50_000))
    directions = np.concatenate([around, ahead])
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    return directions * np.exp(rng.uniform(-2.3, 4.6, len(directions)))[:, None]


@pytest.mark.parametrize("formula, model, size, intrinsics, distortion", CAMERAS)
def test_pixels_and_what_is_visible(bin_dir, formula, model, size, intrinsics, distortion):
    p = points()
    camera = json.dumps({"model": model, "size": size, "intrinsics": intrinsics, "distortion": distortion})
    done = subprocess.run([bin_dir / "tests" / "project_points"], input=camera.encode() + b"\n" + p.tobytes(),
                          capture_output=True, timeout=60)
    assert done.returncode == 0, done.stderr.decode()
    max_angle, *_ = numbers = np.frombuffer(done.stdout)
    uv = numbers[1:].reshape(-1, 2)
    assert len(uv) == len(p)

    b = p / np.linalg.norm(p, axis=1)[:, None]
    angle, end = np.arccos(b[:, 2]), fold(formula, distortion)
    with np.errstate(all="ignore"):
        x, y = formula(b, *distortion)
    expected = np.stack([intrinsics[0] * x + intrinsics[2], intrinsics[1] * y + intrinsics[3]], axis=1)
    edge = np.array(size) - 0.5
    inside = ((expected >= -0.5 + 1e-6) & (expected < edge - 1e-6)).all(axis=1)
    outside = ((expected < -0.5 - 1e-6) | (expected > edge + 1e-6)).any(axis=1)
    visible = ~np.isnan(uv[:, 0])

    # The fold is known to a few samples; double_sphere's published limit is up to a degree and a half early.
    early = 0.03 if model == "double_sphere" else 2e-3
    assert visible[inside & (angle < end - early)].all()
    assert not visible[outside | (angle > end + 2e-3)].any()
    assert np.abs(uv[visible] - expected[visible]).max() < 1e-6
    assert visible.sum() > 5000
    assert angle[visible].max() <= max_angle < angle[visible].max() + np.deg2rad(1)
