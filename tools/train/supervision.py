"""What a recording without labels says of depth: points of a LiDAR at a trusted extrinsic, and the second image of a
stereo camera. All losses are of `output`, N x 1 x H x W, the logarithm of inverse depth."""

import math

import torch
from torch.nn import functional

import data

LOG_SKY = math.log(data.SKY)


def lidar_loss(output, uv, log_inverse, weight):
    """Mean error at the points, of which 90 % of its mean over the frame, the scale, is ignored.

    uv: N x P x 2 pixels of `output`; log_inverse: N x P, -log of the depth in metres; weight: N x P, 0 for none."""
    size = output.new_tensor([output.shape[3], output.shape[2]])
    grid = ((2 * uv + 1) / size - 1)[:, None]
    at_points = functional.grid_sample(output, grid, align_corners=False, padding_mode="border")[:, 0, 0]
    error = at_points - log_inverse
    count = weight.sum(1, keepdim=True).clamp(min=1)
    error = error - 0.9 * (error * weight).sum(1, keepdim=True) / count
    return (error.abs() * weight).sum(1).div(count[:, 0]).mean()


def slopes(x):
    """Mean absolute differences of neighbours at four scales."""
    total = 0.0
    for _ in range(4):
        total = total + (x[..., 1:] - x[..., :-1]).abs().mean() + (x[..., 1:, :] - x[..., :-1, :]).abs().mean()
        x = x[..., ::2, ::2]
    return total


def memory_loss(output, before):
    """How far the network leaves what it was: in the slopes of its depth, which keep edges sharp and fill in what no
    point hits, and in what is sky."""
    sky = before < LOG_SKY
    lost_sky = torch.where(sky, (output - before).clamp(min=0), torch.zeros_like(output))
    new_sky = torch.where(sky, torch.zeros_like(output), (LOG_SKY + 0.2 - output).clamp(min=0))
    return slopes(torch.where(sky, torch.zeros_like(output), output - before)) + (lost_sky + new_sky).mean()


# --- a stereo camera ---

def dissimilarity(a, b):
    """Of images 0 .. 1, for each pixel: 0.85 (1 - SSIM) / 2 + 0.15 |a - b| over 3 x 3 pixels (Godard et al., CVPR 2017)."""
    def mean(x):
        return functional.avg_pool2d(functional.pad(x, (1, 1, 1, 1), mode="replicate"), 3, 1)

    mean_a, mean_b = mean(a), mean(b)
    variance_a, variance_b = mean(a * a) - mean_a ** 2, mean(b * b) - mean_b ** 2
    covariance = mean(a * b) - mean_a * mean_b
    ssim = ((2 * mean_a * mean_b + 1e-4) * (2 * covariance + 9e-4) /
            ((mean_a ** 2 + mean_b ** 2 + 1e-4) * (variance_a + variance_b + 9e-4)))
    return 0.85 * (1 - ssim).clamp(0, 2) / 2 + 0.15 * (a - b).abs()


def seen_by_left(right, disparity):
    """The right image moved to the left one by `disparity` (N x 1 x H x W, pixels), and where it covers it."""
    rows, columns = right.shape[2:]
    x = torch.arange(columns, dtype=right.dtype)[None, None, None] - disparity
    y = torch.arange(rows, dtype=right.dtype)[None, None, :, None].expand_as(x)
    grid = torch.stack([(2 * x + 1) / columns - 1, (2 * y + 1) / rows - 1], -1)[:, 0]
    return functional.grid_sample(right, grid, align_corners=False, padding_mode="border"), (x >= 0) & (x <= columns - 1)


def seen_by_right(disparity):
    """Which pixels of the left image the right camera sees, too: none to the right of them is moved past them. What it does
    not see, at the left of something near, would learn the depth of that."""
    x = torch.arange(disparity.shape[3], dtype=disparity.dtype) - disparity
    least_to_the_right = torch.cummin(x.flip(3), 3).values.flip(3)
    return x <= least_to_the_right + 0.5


COARSE = torch.exp(torch.linspace(-1.5, 1.5, 11))
FINE = torch.exp(torch.linspace(-0.12, 0.12, 5))


def best_scale(output, left, right, focal_baseline):
    """The scale of each frame at which the right image fits best: the network's own means nothing. N x 1 x 1 x 1."""
    with torch.no_grad():
        size = output.shape[2:]
        small = [functional.interpolate(image, size, mode="area") for image in (left, right)]
        factor = focal_baseline * (size[1] / left.shape[3])
        disparity = torch.exp(output) * factor[:, None, None, None]
        scale = torch.ones_like(factor)[:, None, None, None]
        for candidates in (COARSE, FINE):
            errors = []
            for candidate in candidates:
                warped, inside = seen_by_left(small[1], candidate * scale * disparity)
                error = (warped - small[0]).abs() * inside
                errors.append(error.sum((1, 2, 3)) / inside.sum((1, 2, 3)).clamp(min=1))
            scale = scale * candidates[torch.stack(errors).argmin(0)][:, None, None, None]
        return scale


def stereo_loss(output, left, right, focal_baseline):
    """How badly the right image fits the left one by the depth, and how rough inverse depth is where the image is smooth.

    left, right: N x 1 x H' x W', 0 .. 1, of the same part of both images and not smaller than `output`; focal_baseline: N,
    focal length (pixels of `left`) times baseline (metres). Pixels that fit better unmoved are left out: sky, and what
    has no texture."""
    scale = best_scale(output, left, right, focal_baseline)
    inverse = functional.interpolate(torch.exp(output), left.shape[2:], mode="bilinear", align_corners=False)
    disparity = scale * inverse * focal_baseline[:, None, None, None]
    warped, inside = seen_by_left(right, disparity)
    error = dissimilarity(left, warped)
    used = (inside & seen_by_right(disparity.detach()) & (error.detach() < dissimilarity(left, right))).to(error.dtype)
    fit = (error.clamp(max=0.5) * used).sum() / used.sum().clamp(min=1)
    relative = inverse / inverse.mean((2, 3), keepdim=True)
    across = (relative[..., 1:] - relative[..., :-1]).abs() * torch.exp(-10 * (left[..., 1:] - left[..., :-1]).abs())
    down = (relative[..., 1:, :] - relative[..., :-1, :]).abs() * torch.exp(-10 * (left[..., 1:, :] - left[..., :-1, :]).abs())
    return fit + 0.05 * (across.mean() + down.mean())
