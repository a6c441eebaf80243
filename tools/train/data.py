"""Pictures to learn from: rendered by calib-sim, packed once, and another part and exposure of each at every look."""

import argparse
import pathlib
import subprocess

import cv2
import numpy as np

HEIGHT, WIDTH = 256, 640  # of what is rendered
SIZE = (96, 320)          # rows, columns of what the network sees in training
NEAR_M, FAR_M = 0.8, 300.0  # what is nearer or farther counts as this
SKY_LOG = float(np.log(1 / 600))
SKY = 1 / 400  # between the farthest things and the sky


def render(simulator, folder, seeds, frames):
    """Has every seed rendered that is not there yet, and packs all into images.npy and depth.npy of `folder`."""
    folder.mkdir(parents=True, exist_ok=True)
    total = len(seeds) * frames
    shape = (total, HEIGHT, WIDTH)
    images = np.lib.format.open_memmap(folder / "images.npy", "w+", np.uint8, shape)
    depth = np.lib.format.open_memmap(folder / "depth.npy", "w+", np.uint16, shape)
    for i, seed in enumerate(seeds):
        dump = folder / str(seed)
        if not (dump / "depth" / f"{frames - 1:06d}.png").exists():
            subprocess.run([simulator, "--dump", dump, "--vary", "--frames", str(frames), "--seed", str(seed),
                            "--width", str(WIDTH), "--height", str(HEIGHT)], check=True)
        for j in range(frames):
            images[i * frames + j] = cv2.imread(str(dump / "images" / f"{j:06d}.png"), cv2.IMREAD_GRAYSCALE)
            depth[i * frames + j] = cv2.imread(str(dump / "depth" / f"{j:06d}.png"), cv2.IMREAD_UNCHANGED)


class Frames:
    """All frames that were packed into `folders`."""

    def __init__(self, folders):
        self.images = [np.load(folder / "images.npy", mmap_mode="r") for folder in folders]
        self.depth = [np.load(folder / "depth.npy", mmap_mode="r") for folder in folders]
        self.ends = np.cumsum([len(images) for images in self.images])

    def __len__(self):
        return int(self.ends[-1])

    def __getitem__(self, index):
        part = int(np.searchsorted(self.ends, index, "right"))
        within = index - (self.ends[part - 1] if part else 0)
        return self.images[part][within], self.depth[part][within]


def log_inverse(depth_u16):
    """Logarithm of inverse depth (1/m); SKY_LOG where there is none."""
    metres = np.clip(depth_u16.astype(np.float32) / 256, NEAR_M, FAR_M)
    return np.where(depth_u16 > 0, -np.log(metres), SKY_LOG).astype(np.float32)


def resized(image, depth, size):
    rows, columns = size
    return (cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA),
            cv2.resize(depth, (columns, rows), interpolation=cv2.INTER_NEAREST))


def crop(rng, image, depth, size):
    """Any part of the picture that is not too small: neither the row nor the size of a thing tells its depth alone."""
    rows, columns = size
    width = int(WIDTH * rng.uniform(0.5, 1) ** 0.7)
    height = min(HEIGHT, int(width * rows / columns * np.exp(rng.uniform(-0.18, 0.3))))
    left = rng.integers(0, WIDTH - width + 1)
    middle = (HEIGHT - height) / 2
    top = int(np.clip(middle + rng.normal() * 0.12 * HEIGHT, 0, HEIGHT - height))
    window = np.s_[top:top + height, left:left + width]
    image, depth = resized(np.ascontiguousarray(image[window]), np.ascontiguousarray(depth[window]), size)
    if rng.random() < 0.5:
        image, depth = image[:, ::-1], depth[:, ::-1]
    return image, depth


def smooth_field(rng, size, cells):
    """A random field of about -1 .. 1 that changes slowly."""
    coarse = rng.uniform(-1, 1, (cells, 2 * cells)).astype(np.float32)
    return cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC)


def other_sky(rng, x, depth):
    """Skies differ more than anything else, and a camera that is set for the road sees them white."""
    sky = cv2.blur((depth == 0).astype(np.float32), (2, 2))
    ramp = np.linspace(0, 1, x.shape[0], dtype=np.float32)[:, None]
    new = rng.uniform(0.3, 1.4) - rng.uniform(-0.2, 0.5) * (1 - ramp)
    new = new + rng.uniform(0, 0.15) * smooth_field(rng, x.shape, 4)
    return x + sky * (new - x)


def dark_places(rng, x):
    """Shadows of what is not in the picture: sharp, and blind to what they fall on."""
    mask = np.zeros(x.shape, np.uint8)
    for _ in range(rng.integers(1, 4)):
        centre = np.array([rng.uniform(0, x.shape[1]), rng.uniform(0.3, 1.1) * x.shape[0]])
        corners = centre + rng.normal(size=(rng.integers(3, 8), 2)) * [60 * rng.random() + 8, 14 * rng.random() + 3]
        cv2.fillPoly(mask, [np.int32(corners)], 255)
    mask = cv2.blur(mask, (3, 3)).astype(np.float32) / 255
    return x * (1 - mask * rng.uniform(0.3, 0.85))


def seen_by_some_camera(rng, image, depth):
    x = image.astype(np.float32) / 255
    if rng.random() < 0.3:
        x = dark_places(rng, x)
    if rng.random() < 0.35:  # fine texture that nobody renders
        x = x * (1 + rng.uniform(0, 0.35) * smooth_field(rng, x.shape, int(rng.integers(12, 60))))
    if rng.random() < 0.75:
        x = other_sky(rng, x, depth)
    if rng.random() < 0.25:
        x = x * (1 + rng.uniform(0, 0.35) * smooth_field(rng, x.shape, rng.integers(2, 5)))
    x = np.clip(x, 0, None)
    if rng.random() < 0.8:
        x = x ** np.exp(rng.uniform(-0.5, 0.8))
    if rng.random() < 0.8:
        low, high = np.quantile(x, [0.02, 0.95])
        gain = rng.uniform(0.5, 1.5) / max(high - low, 0.1)
        x = (x - low) * gain + rng.uniform(0, 0.15)
    kind = rng.random()
    if kind < 0.25:
        x = cv2.GaussianBlur(x, (0, 0), rng.uniform(0.3, 1.1))
    elif kind < 0.55:
        x = x + rng.uniform(0.2, 1.2) * (x - cv2.GaussianBlur(x, (0, 0), 1.0))
    if rng.random() < 0.6:
        x = x + rng.uniform(0, 0.05) * rng.standard_normal(x.shape, np.float32)
    pixels = np.clip(255 * x, 0, 255).astype(np.uint8)
    if rng.random() < 0.2:
        quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(25, 90))]
        pixels = cv2.imdecode(cv2.imencode(".jpg", pixels, quality)[1], cv2.IMREAD_GRAYSCALE)
    return pixels


def batch(frames, seed, step, count, size=SIZE):
    """Batch `step` of a seed: images of 0 .. 1, and logarithms of inverse depth."""
    rng = np.random.default_rng((seed, step))
    images, targets = [], []
    for index in rng.integers(0, len(frames), count):
        image, depth = crop(rng, *frames[index], size)
        images.append(seen_by_some_camera(rng, image, depth))
        targets.append(log_inverse(depth))
    return np.stack(images)[:, None].astype(np.float32) / 255, np.stack(targets)[:, None]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=pathlib.Path)
    parser.add_argument("--simulator", default="calib-sim")
    parser.add_argument("--seeds", default="1-16", help="first-last")
    parser.add_argument("--frames", type=int, default=500, help="of every seed")
    options = parser.parse_args()
    first, last = map(int, options.seeds.split("-"))
    cv2.setNumThreads(1)
    render(options.simulator, options.folder, range(first, last + 1), options.frames)


if __name__ == "__main__":
    main()
