#!/usr/bin/env python3
"""Draws the demo's picture: LiDAR points on the camera image, before and after the recalibration, side by side. Of several
frames it takes the one, and the part of it, that shows the difference best.

  demo_picture.py FOLDER OUT.png TITLE BEFORE AFTER

For each frame NAME, FOLDER holds three pictures that --overlay of calib-sim or calib-replay has written: NAME-image.png with
no LiDAR point in view, NAME-before.png and NAME-after.png with the points. BEFORE and AFTER are the captions of the halves."""

import pathlib
import sys

import matplotlib
import numpy

matplotlib.use("Agg")
from matplotlib import colors, lines, pyplot, ticker  # noqa: E402

CROP_WIDTH = 0.21  # share of the image's width
CROP_ASPECT = 1.5
FARTHEST_EDGE_M = 25
ROW_PX = 3         # dots that are no further apart vertically belong to one row
RANGE_TICKS_M = (4, 6, 10, 15, 25, 40, 60)
COLOURS = colors.ListedColormap(matplotlib.colormaps["turbo_r"](numpy.linspace(0.04, 0.94, 256)))
RANGE_SCALE = colors.LogNorm(RANGE_TICKS_M[0], RANGE_TICKS_M[-1])


class Points:
    """The dots of an overlay: columns u and rows v in pixels, and ranges. write_overlay() of calib/overlay.hpp draws a point at
    range r as a centre with four neighbours, in entry 250 exp(-r / 25 m) of the colour table `turbo`."""

    def __init__(self, overlay, image):
        inner = overlay[1:-1, 1:-1]
        is_centre = (numpy.abs(overlay - image).max(axis=2) > 0.02)[1:-1, 1:-1]
        for neighbour in (overlay[:-2, 1:-1], overlay[2:, 1:-1], overlay[1:-1, :-2], overlay[1:-1, 2:]):
            is_centre &= (neighbour == inner).all(axis=2)
        rows, columns = numpy.nonzero(is_centre)
        self.u, self.v = columns + 1, rows + 1
        table = matplotlib.colormaps["turbo"](numpy.arange(251))[:, :3]
        distance = ((overlay[self.v, self.u][:, None] - table[None]) ** 2).sum(axis=2)
        self.range_m = -25 * numpy.log(numpy.maximum(distance.argmin(axis=1), 1) / 250)

    def edges(self):
        """Dots at the left and at the right edges of near objects: the next dot of the row is at least half as far again."""
        order = numpy.lexsort((self.u, self.v // ROW_PX))
        a, b = order[:-1], order[1:]
        neighbours = (self.v[a] // ROW_PX == self.v[b] // ROW_PX) & (self.u[b] - self.u[a] <= 12)
        neighbours &= numpy.minimum(self.range_m[a], self.range_m[b]) < FARTHEST_EDGE_M
        left = b[neighbours & (self.range_m[a] > 1.5 * self.range_m[b])]
        right = a[neighbours & (self.range_m[b] > 1.5 * self.range_m[a])]
        return left, right


class Frame:
    def __init__(self, folder, name):
        self.image, before, after = (
            pyplot.imread(folder / f"{name}-{kind}.png")[:, :, :3] for kind in ("image", "before", "after"))
        self.before, self.after = Points(before, self.image), Points(after, self.image)
        self.gain, self.crop = self._best_crop()

    def _best_crop(self):
        """The crop (left, top, width, height) in which most edges of near objects lie on an edge of the image after the
        recalibration and did not before, and a measure of that."""
        height, width = self.image.shape[:2]
        crop_w, crop_h = round(CROP_WIDTH * width), round(CROP_WIDTH * width / CROP_ASPECT)
        slope = numpy.abs(numpy.gradient(self.image[:, :, 0], axis=1))
        slope = numpy.max([numpy.roll(slope, shift, axis=1) for shift in (-2, -1, 0, 1, 2)], axis=0)
        # The middle of a crop counts most.
        window = numpy.fft.rfft2(numpy.outer(numpy.hanning(crop_h), numpy.hanning(crop_w)), (height, width)).conj()

        def gain(side):
            change = numpy.zeros((height, width))
            for points, sign in ((self.before, -1), (self.after, 1)):
                at = points.edges()[side]
                numpy.add.at(change, (points.v[at], points.u[at]), sign * slope[points.v[at], points.u[at]])
            return numpy.fft.irfft2(numpy.fft.rfft2(change) * window, (height, width))[:height - crop_h, :width - crop_w]

        gains = numpy.minimum(gain(0), gain(1))  # an object that is in view from its left to its right edge
        top, left = numpy.unravel_index(gains.argmax(), gains.shape)
        return gains[top, left], (left, top, crop_w, crop_h)


def draw(frame, title, captions, out):
    left, top, width, height = frame.crop
    figure, axes = pyplot.subplots(1, 2, figsize=(13, 6.6), layout="constrained")
    for axis, points, caption in zip(axes, (frame.before, frame.after), captions):
        axis.imshow(frame.image[:, :, 0], cmap="gray", vmin=-0.05, vmax=1.3, interpolation="bicubic")
        dots = axis.scatter(points.u, points.v, c=points.range_m, cmap=COLOURS, norm=RANGE_SCALE, s=16, linewidths=0)
        at = numpy.concatenate(points.edges())
        for colour, line_width in (("black", 3.4), ("white", 1.8)):
            axis.scatter(points.u[at], points.v[at], s=60, facecolors="none", edgecolors=colour, linewidths=line_width)
        axis.set(xlim=(left, left + width), ylim=(top + height, top), xticks=[], yticks=[])
        axis.set_title(caption, fontsize=14)
    bar = figure.colorbar(dots, ax=axes, location="bottom", shrink=0.6, aspect=40, ticks=RANGE_TICKS_M,
                          format=ticker.FormatStrFormatter("%g m"))
    bar.ax.minorticks_off()
    bar.set_label("dot: a LiDAR point, its colour is its distance", fontsize=12)
    ring = lines.Line2D([], [], linestyle="none", marker="o", markersize=9, markerfacecolor="0.5", markeredgecolor="white",
                        markeredgewidth=1.8, label="ring: a LiDAR point on the edge of a near object; it belongs on the edge "
                        "of that object in the image")
    figure.legend(handles=[ring], loc="outside lower center", fontsize=12, facecolor="0.5", labelcolor="white")
    figure.suptitle(title, fontsize=15, fontweight="bold")
    figure.savefig(out, dpi=100)


def main():
    if len(sys.argv) != 6:
        sys.exit(__doc__)
    folder, out, title, *captions = sys.argv[1:]
    frames = [Frame(pathlib.Path(folder), path.name.removesuffix("-image.png"))
              for path in sorted(pathlib.Path(folder).glob("*-image.png"))]
    draw(max(frames, key=lambda frame: frame.gain), title, captions, out)


if __name__ == "__main__":
    main()
