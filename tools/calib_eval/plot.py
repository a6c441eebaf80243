#!/usr/bin/env python3
"""Draws what calib-eval --json wrote: bull's-eye plots, hit rates, joint histograms, overlays, curves, surfaces, drift."""

import argparse
import json
import pathlib
import sys

try:
    import matplotlib
    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    import numpy as np
    from matplotlib.lines import Line2D
    from matplotlib.patches import Circle
    from matplotlib.ticker import MaxNLocator
    from PIL import Image
except ImportError as error:
    sys.exit(f"calib-eval: {error.name} is missing: install python3-matplotlib")

AXES = ["roll", "pitch", "yaw", "x", "y", "z"]
HIT_DEG, HIT_CM = 0.5, 20
GOOD, BAD, STARTS = "#0072b2", "#d55e00", "#8c8c8c"
LINES = ["#0072b2", "#d55e00", "#009e73", "#cc79a7"]
VERDICTS = {"learning": "#d9d9d9", "insufficient_power": "#d8cfe6", "calibrated": "#d5ecd4", "suspect": "#ffe3a8", "drifted": "#f6b5a0"}
VIEW_TITLES = {"start": "Before", "end": "After", "truth": "Recording's own extrinsic"}


def cell_name(cell):
    name = f"{cell['objective']}_{cell['dof']}dof_{cell['rotation_deg']:g}deg"
    return name + (f"_{cell['translation_cm']:g}cm" if cell["dof"] == 6 else "")


def start_title(cell):
    rotation = "any orientation" if cell["rotation_deg"] == 180 else f"{cell['rotation_deg']:g}°"
    return rotation + (f", {cell['translation_cm']:g} cm" if cell["dof"] == 6 else "")


def cell_title(cell):
    starts = f"starts of {start_title(cell)}" if cell["rotation_deg"] == 180 else f"starts {start_title(cell)} off"
    return f"{cell['objective']}, {cell['dof']} DoF, {starts}"


class Canvas:
    """A folder for pictures, which says which ones were drawn, and knows what was missing for others."""

    def __init__(self, folder):
        self.folder, self.drawn, self.missing = folder, 0, []

    def save(self, figure, name):
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / f"{name}.png".replace("/", "_")
        path.unlink(missing_ok=True)
        with open(path, "xb") as file:  # a new one, never what a symbolic link points to
            figure.savefig(file, dpi=120)
        plt.close(figure)
        self.drawn += 1
        print(path)


def legend_below(figure, entries):
    """Under all panels, in room of its own. (Debian 12's matplotlib knows no "outside" yet.)"""
    room = 0.4 / figure.get_size_inches()[1]
    figure.get_layout_engine().set(rect=(0, room, 1, 1 - room))
    figure.legend(handles=entries, loc="lower center", ncols=len(entries), frameon=False)


# --- calibrate ---

def bullseye_panel(panel, starts, ends, hits, axes, unit, reach, limit):
    """Starts (x) joined to ends (dot) in the plane of two axes, the truth in the centre; ends alone when zoomed in."""
    i, j = axes
    if starts is not None:
        panel.plot([starts[:, i], ends[:, i]], [starts[:, j], ends[:, j]], color=STARTS, lw=0.4, alpha=0.5, zorder=1)
        panel.plot(starts[:, i], starts[:, j], "x", color=STARTS, ms=4, zorder=2)
    for chosen, colour in ((~hits, BAD), (hits, GOOD)):
        panel.plot(ends[chosen, i], ends[chosen, j], ".", color=colour, ms=5, zorder=3)
    rings = MaxNLocator(3, steps=[1, 2, 5, 10]).tick_values(0, reach)
    rings = rings[(rings > 0) & (rings <= reach)]
    for ring in rings:
        panel.add_patch(Circle((0, 0), ring, fill=False, color="0.88", lw=0.8, zorder=0))
    panel.add_patch(Circle((0, 0), limit, fill=False, color=GOOD, lw=1, ls="--", zorder=0))
    panel.axhline(0, color="0.8", lw=0.8, zorder=0)
    panel.axvline(0, color="0.8", lw=0.8, zorder=0)
    ticks = [*-rings[::-1], 0, *rings]
    panel.set(xlim=(-reach, reach), ylim=(-reach, reach), xticks=ticks, yticks=ticks, aspect="equal",
              xlabel=f"{AXES[i]} ({unit})", ylabel=f"{AXES[j]} ({unit})")


def bullseye(canvas, cell, runs):
    """One figure for rotation, and one for translation where it is sought."""
    ended = [run for run in runs if run["end"] is not None]
    if not ended:
        return
    starts, ends = (np.array([run[key] for run in ended]) for key in ("start", "end"))
    hits = np.array([run["hit"] for run in ended])
    groups = [("rotation", 0, "deg", HIT_DEG)] + ([("translation", 3, "cm", HIT_CM)] if cell["dof"] == 6 else [])
    for name, first, unit, limit in groups:
        reach = 1.08 * max(np.abs(starts[:, first:first + 3]).max(), limit)
        figure, panels = plt.subplots(2, 3, figsize=(12, 8.6), layout="constrained")
        for column, axes in enumerate([(first + 2, first + 1), (first + 2, first), (first + 1, first)]):
            bullseye_panel(panels[0, column], starts, ends, hits, axes, unit, reach, limit)
            bullseye_panel(panels[1, column], None, ends, hits, axes, unit, 1.2 * limit, limit)
        figure.suptitle(f"{cell_title(cell)}: {100 * cell['hit_rate']:.1f} % hits of {cell['starts']}\n"
                        f"residual {name}; above all runs, below the ends near the truth")
        legend_below(figure, [Line2D([], [], color=STARTS, marker="x", lw=0.6, label="start"),
                              Line2D([], [], color=GOOD, marker=".", lw=0, label="end, a hit"),
                              Line2D([], [], color=BAD, marker=".", lw=0, label="end, not a hit"),
                              Line2D([], [], color=GOOD, ls="--", lw=1, label=f"{limit:g} {unit} off")])
        canvas.save(figure, f"bullseye_{name}_{cell_name(cell)}")


def hit_rates(canvas, cells):
    for dof in sorted({cell["dof"] for cell in cells}):
        chosen = [cell for cell in cells if cell["dof"] == dof]
        objectives = list(dict.fromkeys(cell["objective"] for cell in chosen))
        ranges = list(dict.fromkeys(start_title(cell) for cell in chosen))
        figure, panel = plt.subplots(figsize=(max(5.0, 1.2 * len(ranges) + 0.5 * len(objectives) * len(ranges)), 4.2),
                                     layout="constrained")
        width = 0.8 / len(objectives)
        for k, objective in enumerate(objectives):
            rates = {start_title(cell): 100 * cell["hit_rate"] for cell in chosen if cell["objective"] == objective}
            places = [i + (k - (len(objectives) - 1) / 2) * width for i, name in enumerate(ranges) if name in rates]
            bars = panel.bar(places, list(rates.values()), 0.92 * width, label=objective, color=LINES[k % len(LINES)])
            panel.bar_label(bars, fmt="%.3g", fontsize=8)
        panel.set(xticks=range(len(ranges)), xticklabels=ranges, ylim=(0, 108), ylabel="hits (%)",
                  xlabel="how far off the starts are", title=f"{dof} DoF, {chosen[0]['starts']} starts")
        panel.legend(loc="upper left", bbox_to_anchor=(1, 1), frameon=False)
        canvas.save(figure, f"hits_{dof}dof")


def joint_histograms(canvas, figure_json, cell):
    """How the points of one frame fall on the classes of both features, before, after, and as it ought to be."""
    views = [view for view in figure_json["views"] if sum(view["histogram"])]
    if not views:
        return
    tables = [np.array(view["histogram"], float).reshape(2 * [figure_json["classes"]]) for view in views]
    tables = [100 * table / table.sum() for table in tables]
    point, pixel = (("LiDAR distance", "image depth") if figure_json["features"] == "depth" else
                    ("LiDAR reflectance", "image brightness"))
    figure, panels = plt.subplots(1, len(views), figsize=(4.1 * len(views) + 0.8, 4.6), layout="constrained", squeeze=False)
    top = max(np.quantile(table, 0.995) for table in tables)
    for panel, view, table in zip(panels[0], views, tables):
        shown = panel.imshow(table.T, origin="lower", extent=(0, 100, 0, 100), cmap="magma_r", vmin=0, vmax=top)
        panel.set(title=f"{VIEW_TITLES[view['view']]}, score {view['score']:.4f}", xlabel=f"{point} (percentile)",
                  ylabel=f"{pixel} (percentile)")
    figure.colorbar(shown, ax=panels, label="share of the points (%)", extend="max", shrink=0.85)
    figure.suptitle(f"{cell_title(cell)}: joint histograms of run {figure_json['run']}, frame {figure_json['frame']}")
    canvas.save(figure, f"histograms_{cell_name(cell)}")


def overlays(canvas, figure_json, cell, base):
    pictures = []
    for view in figure_json["views"]:
        path = base / view["overlay"]
        try:
            with open(path if path.is_file() else "", "rb") as file:  # a FIFO would be waited for
                pictures.append((VIEW_TITLES[view["view"]], np.asarray(Image.open(file))))
        except (OSError, SyntaxError, Image.DecompressionBombError):
            canvas.missing.append(path)
    if not pictures:
        return
    height, width = pictures[0][1].shape[:2]
    wide = width > 1.5 * height
    rows, columns = (len(pictures), 1) if wide else (1, len(pictures))
    across = 11 if wide else 4.5
    figure, panels = plt.subplots(rows, columns, figsize=(across * columns, (across * height / width + 0.3) * rows + 0.6),
                                  layout="constrained", squeeze=False)
    for panel, (title, picture) in zip(panels.flat, pictures):
        panel.imshow(picture)
        panel.set_title(title)
        panel.axis("off")
    figure.suptitle(f"{cell_title(cell)}: run {figure_json['run']}, frame {figure_json['frame']}; near points red, far blue")
    canvas.save(figure, f"overlay_{cell_name(cell)}")


def draw_calibrate(canvas, result, base):
    for number, cell in enumerate(result["cells"]):
        bullseye(canvas, cell, [run for run in result["runs"] if run["cell"] == number])
    hit_rates(canvas, result["cells"])
    for figure_json in result.get("figures", []):
        cell = result["cells"][figure_json["cell"]]
        joint_histograms(canvas, figure_json, cell)
        overlays(canvas, figure_json, cell, base)


# --- curve and surface ---

def draw_curve(canvas, result, _base):
    """Objectives have scales of their own, so each is drawn from the lowest to the highest of its scores."""
    curves = result["curves"]
    objectives = list(dict.fromkeys(curve["objective"] for curve in curves))
    figure, panels = plt.subplots(2, 3, figsize=(12, 7), layout="constrained", sharey=True)
    lowest, highest = {}, {}
    for name in objectives:
        scores = [score for curve in curves if curve["objective"] == name for score in curve["score"]]
        lowest[name], highest[name] = min(scores), max(scores)
    for panel, axis in zip(panels.flat, AXES):
        panel.axvline(0, color="0.8", lw=1)
        for curve in (curve for curve in curves if curve["axis"] == axis):
            name = curve["objective"]
            colour = LINES[objectives.index(name) % len(LINES)]
            scores = (np.array(curve["score"]) - lowest[name]) / ((highest[name] - lowest[name]) or 1)
            panel.plot(curve["offset"], scores, color=colour)
            best = int(np.argmax(scores))
            panel.plot(curve["offset"][best], scores[best], "o", color=colour, ms=5)
            panel.set_xlabel(f"{axis} ({curve['unit']})")
        panel.grid(color="0.92")
    for row in panels:
        row[0].set_ylabel("score, lowest 0, highest 1")
    legend_below(figure, [Line2D([], [], color=LINES[k % len(LINES)], marker="o", ms=5,
                                 label=f"{name} ({lowest[name]:.3f} to {highest[name]:.3f})")
                          for k, name in enumerate(objectives)])
    figure.suptitle(f"Score along each axis about the recording's extrinsic, {len(result['recording']['frames'])} frames; "
                    "dots: the best")
    canvas.save(figure, "curves")


def draw_surface(canvas, result, _base):
    for objective in dict.fromkeys(surface["objective"] for surface in result["surfaces"]):
        surfaces = [surface for surface in result["surfaces"] if surface["objective"] == objective]
        columns = min(3, len(surfaces))
        rows = -(-len(surfaces) // columns)
        figure = plt.figure(figsize=(4.8 * columns, 4.6 * rows + 0.5), layout="constrained")
        for k, surface in enumerate(surfaces):
            panel = figure.add_subplot(rows, columns, k + 1, projection="3d")
            first, second = surface["offset"]
            score = np.array(surface["score"])
            across, along = np.meshgrid(first, second, indexing="ij")
            panel.plot_surface(across, along, score, cmap="viridis", rcount=60, ccount=60, linewidth=0)
            best = np.unravel_index(np.argmax(score), score.shape)
            names, units = surface["axes"], surface["units"]
            panel.set_xlabel(f"{names[0]} ({units[0]})", labelpad=8)
            panel.set_ylabel(f"{names[1]} ({units[1]})", labelpad=10)
            panel.set_zlabel("score", labelpad=13)
            panel.tick_params(axis="z", pad=6)
            panel.zaxis.set_major_locator(MaxNLocator(5))
            panel.view_init(elev=32, azim=-55)
            panel.set_box_aspect((1, 1, 0.75), zoom=0.78)
            panel.set_title(f"best at {names[0]} {first[best[0]]:.3g} {units[0]}, "
                            f"{names[1]} {second[best[1]]:.3g} {units[1]}", fontsize=10, y=0.94)
        figure.suptitle(f"{objective}: score about the recording's extrinsic, {len(result['recording']['frames'])} frames")
        canvas.save(figure, f"surfaces_{objective}")


# --- drift ---

def movement(entry):
    return f"{entry['axis']} {entry['magnitude']:+g} {entry['unit']}"


def timelines(canvas, entries):
    """The verdict as a band of colour, and how near each axis's evidence comes to its limit."""
    shown_before, shown = 20, set()
    columns = min(3, len(entries))
    rows = -(-len(entries) // columns)
    figure, panels = plt.subplots(rows, columns, figsize=(4.6 * columns, 3.1 * rows + 0.9), layout="constrained", sharey=True,
                                  squeeze=False)
    for panel in panels.flat[len(entries):]:
        panel.axis("off")
    for panel, entry in zip(panels.flat, entries):
        pairs = np.arange(len(entry["verdict"])) - entry["moved_at"] + 1
        for pair, verdict in zip(pairs, entry["verdict"]):
            panel.axvspan(pair - 0.5, pair + 0.5, color=VERDICTS[verdict], lw=0)
        shown |= set(np.array(entry["verdict"])[pairs > -shown_before])
        evidence, own = np.array(entry["evidence"]), AXES.index(entry["axis"])
        for axis in range(6):
            panel.plot(pairs, evidence[:, axis], color=LINES[0] if axis == own else STARTS, lw=2 if axis == own else 0.9,
                       zorder=3 if axis == own else 2)
        panel.plot(pairs, evidence[:, 6], color=LINES[1], lw=1.3)
        panel.axhline(1, color="0.3", lw=0.8, ls="--")
        panel.axvline(0.5, color="0.1", lw=1.2)
        panel.set(xlim=(max(pairs[0], -shown_before) - 0.5, pairs[-1] + 0.5), ylim=(0, 1.3), title=movement(entry),
                  xlabel="pairs since the LiDAR has moved")
    for row in panels:
        row[0].set_ylabel("evidence / limit (never above 1.2)")
    figure.suptitle("Verdict and evidence, one sequence each")
    legend_below(figure, [Line2D([], [], color=LINES[0], lw=2, label="the axis itself"),
                          Line2D([], [], color=STARTS, lw=0.9, label="the others"),
                          Line2D([], [], color=LINES[1], lw=1.3, label="the score's peak is lost"),
                          *(Line2D([], [], color=colour, lw=8, label=name) for name, colour in VERDICTS.items()
                            if name in shown)])
    canvas.save(figure, "timelines")


def groups(entries):
    """Movements by unit, then axis: (magnitude to either side, entries)."""
    found = {}
    for entry in entries:
        found.setdefault(entry["unit"], {}).setdefault(entry["axis"], {}).setdefault(abs(entry["magnitude"]), []).append(entry)
    return found


def delays(canvas, entries, limit):
    """Median and 5 to 95 % of the delay, both sides together; a triangle where more than these 5 % are never found."""
    units = groups(entries)
    figure, panels = plt.subplots(1, len(units), figsize=(6 * len(units), 4.4), layout="constrained", squeeze=False, sharey=True)
    for panel, (unit, axes) in zip(panels[0], units.items()):
        places = sorted({magnitude for magnitudes in axes.values() for magnitude in magnitudes})
        for k, (axis, magnitudes) in enumerate(axes.items()):
            for magnitude, found in magnitudes.items():
                all_delays = sorted(np.inf if delay is None else delay for entry in found for delay in entry["delays"])
                if not all_delays:
                    continue
                low, middle, high = (all_delays[max(0, int(np.ceil(share * len(all_delays))) - 1)] for share in (0.05, 0.5, 0.95))
                at = places.index(magnitude) + 0.2 * (k - (len(axes) - 1) / 2)
                colour = LINES[k % len(LINES)]
                panel.plot([at, at], [min(low, limit), min(high, limit)], color=colour, lw=2)
                panel.plot(at, min(middle, limit), "o", color=colour, ms=7, mfc=colour if middle <= limit else "white")
                if high > limit:
                    panel.plot(at, limit, "^", color=colour, ms=9)
        panel.set(yscale="log", ylim=(1, 1.4 * limit), xlim=(-0.6, len(places) - 0.4), xticks=range(len(places)),
                  xticklabels=[f"{place:g}" for place in places], xlabel=f"how far the LiDAR moves ({unit})")
        panel.yaxis.set_major_formatter("{x:g}")
        panel.grid(axis="y", color="0.9")
        panel.legend(handles=[Line2D([], [], color=LINES[k % len(LINES)], marker="o", lw=2, label=axis)
                              for k, axis in enumerate(axes)], frameon=False, loc="lower right")
    panels[0, 0].set_ylabel("pairs until drifted")
    figure.suptitle("Delay: median, 5 to 95 % of the sequences\n(triangle: more than 5 % are not found)")
    canvas.save(figure, "delays")


def operating_curve(canvas, points):
    """False alarms that are allowed against those measured, and against the median delay of the worse side."""
    allowed = [point["false_alerts_per_1000_vehicle_weeks"] for point in points]
    curves = {}
    for i, point in enumerate(points):
        for unit, axes in groups(point["knocks"]).items():
            for axis, magnitudes in axes.items():
                for magnitude, sides in magnitudes.items():
                    medians = [side["median_delay_pairs"] for side in sides]
                    worst = np.nan if None in medians else max(medians)
                    curves.setdefault((unit, magnitude), {}).setdefault(axis, [np.nan] * len(points))[i] = worst
    columns = min(3, 1 + len(curves))
    rows = -(-(1 + len(curves)) // columns)
    figure, panels = plt.subplots(rows, columns, figsize=(4.4 * columns, 3.5 * rows + 0.4), layout="constrained", squeeze=False)
    for panel in panels.flat[1 + len(curves):]:
        panel.axis("off")
    first = panels[0, 0]
    ends = [allowed[0] / 3, allowed[-1] * 3]
    first.plot(ends, ends, color="0.6", ls="--", lw=1)
    for x, point in zip(allowed, points):
        rate, upper = (point["null"][key] for key in ("rate_per_1000_vehicle_weeks", "upper95"))
        if upper is not None:
            first.plot([x, x], [rate or upper, upper], color=LINES[0], lw=2)
            first.plot(x, rate or upper, "o" if rate else "v", color=LINES[0], ms=7)
    first.set(xscale="log", yscale="log", ylabel="false alarms in 1000 vehicle-weeks")
    first.set_title("measured, and up to its bound at 95 %\n(triangle: none seen, the bound alone)", fontsize=10)
    highest = max((delay for curve in curves.values() for medians in curve.values() for delay in medians if delay == delay),
                  default=1)
    for panel, ((unit, magnitude), axes) in zip(panels.flat[1:], curves.items()):
        for k, (axis, medians) in enumerate(axes.items()):
            places = np.array(allowed) * 1.25 ** (k - 1)  # side by side where they are alike
            panel.plot(places, medians, color=LINES[k % len(LINES)], marker="o", ms=5, label=axis)
            never = np.isnan(medians)
            panel.plot(places[never], np.full(never.sum(), 1.12 * highest), "^", color=LINES[k % len(LINES)], ms=6)
        panel.set(xscale="log", ylim=(0, 1.2 * highest), title=f"{magnitude:g} {unit}", ylabel="median delay (pairs)")
    legend_below(figure, [Line2D([], [], color=LINES[k], marker="o", ms=5, label=label)
                          for k, label in enumerate(["roll or x", "pitch or y", "yaw or z"])]
                 + [Line2D([], [], color="0.4", marker="^", lw=0, label="half are not found")])
    for panel in panels.flat[:1 + len(curves)]:
        panel.set(xlim=ends, xlabel="allowed in 1000 vehicle-weeks")
        panel.grid(color="0.92")
    figure.suptitle("What allowing more false alarms would gain")
    canvas.save(figure, "operating")


def draw_drift(canvas, result, _base):
    if result["timelines"]:
        timelines(canvas, result["timelines"])
    delays(canvas, result["knocks"], result["settings"]["pairs"])
    operating_curve(canvas, result["operating"])


def main():
    parser = argparse.ArgumentParser(prog="calib-eval plot", description=__doc__)
    parser.add_argument("--out", type=pathlib.Path, required=True, help="folder for the pictures")
    parser.add_argument("result", type=pathlib.Path)
    arguments = parser.parse_args()
    canvas = Canvas(arguments.out)
    draw = {"calibrate": draw_calibrate, "curve": draw_curve, "surface": draw_surface, "drift": draw_drift}
    try:
        result = json.loads(arguments.result.read_text())
        if result["schema"] != 1:
            sys.exit(f"calib-eval: {arguments.result} has schema {result['schema']}, and this program draws schema 1")
        if not result.get("complete", True):
            print(f"calib-eval: {arguments.result} is not complete: what wrote it goes on, or was stopped", file=sys.stderr)
        draw[result["kind"]](canvas, result, arguments.result.resolve().parent)
    except OSError as error:
        sys.exit(f"calib-eval: {error.filename}: {error.strerror}")
    except (ValueError, LookupError, TypeError, RecursionError, MemoryError) as error:
        sys.exit(f"calib-eval: {arguments.result} is not a result of calib-eval ({type(error).__name__}: {error})")
    if canvas.missing:
        sys.exit(f"calib-eval: {len(canvas.missing)} overlays cannot be read and are not drawn, the first: {canvas.missing[0]}")
    if not canvas.drawn:
        sys.exit(f"calib-eval: {arguments.result} holds nothing to draw")


if __name__ == "__main__":
    main()
