"""Fine-tunes a network of tools/train on recordings of one's own vehicle, without labels: by the LiDAR at an extrinsic that
is trusted, or by the right camera of a stereo camera. Validates on frames that it did not learn from, and writes nothing that
is not better there. The same command gives the same weights on the same machine; run again, it goes on where it stopped."""

import argparse
import copy
import hashlib
import json
import math
import pathlib
import sys
import time

import cv2
import numpy as np
import torch
import yaml

import data
import export
import supervision
from evaluate import spearman
from network import DepthNetwork, without_batch_norm
from recordings import RecordingError, open_recording, visible_points

POINTS = 2048  # of a frame, in a step
PASSES = 30    # over the frames, where --steps is not given
SHARPER = 2    # images for the stereo loss, in pixels of the network's input
BOX = pathlib.Path(__file__).parents[2] / "libcalib/models/street-small.yaml"


class Refused(Exception):
    """One sentence for the user."""


# --- the network ---

def input_size(camera):
    """Rows and columns of the network's input, by the descriptor that export.py writes."""
    factor = min(320 / camera.width, 320 / camera.height)

    def side(length):
        return max(32, min(round(length * factor / 32) * 32, 320))
    return side(camera.height), side(camera.width)


def load(path):
    """From a descriptor, or from a checkpoint.pt of train.py."""
    if path.suffix == ".pt":
        network = DepthNetwork().eval()
        network.load_state_dict(torch.load(path)["smooth"])
        return without_batch_norm(network), BOX.parent / "street-small-golden.png"
    descriptor = yaml.safe_load(path.read_text())
    golden = descriptor.get("golden", {}).get("image")
    return (export.load_onnx(path.parent / descriptor["file"]),
            path.parent / golden if golden else BOX.parent / "street-small-golden.png")


# --- frames to learn from ---

class Lessons:
    """Frames of a recording that are learned from, each kept in memory: images and the points that the camera sees."""

    def __init__(self, recordings, supervision_name):
        self.by_lidar = supervision_name != "stereo"
        self.by_stereo = supervision_name != "lidar"
        self.size = input_size(recordings[0][0].camera)
        self.frames = []
        for recording, frames in recordings:
            for frame in frames:
                right = recording.right_image(frame) if self.by_stereo else None
                points = visible_points(recording, frame) if self.by_lidar else None
                self.frames.append((recording, recording.image(frame), right, points))

    def window(self, rng, image):
        """A part of the image, of the aspect ratio of the network's input: left, top, width, height."""
        rows, columns = self.size
        full = min(image.shape[1], image.shape[0] * columns / rows)
        width = int(full * rng.uniform(0.75, 1))
        height = min(image.shape[0], int(width * rows / columns))
        return (rng.integers(0, image.shape[1] - width + 1), rng.integers(0, image.shape[0] - height + 1), width, height)

    def one(self, rng, index):
        recording, image, right, points = self.frames[index]
        left, top, width, height = self.window(rng, image)
        part = np.s_[top:top + height, left:left + width]
        rows, columns = self.size
        small = cv2.resize(image[part], (columns, rows), interpolation=cv2.INTER_AREA)
        lesson = {"plain": small}
        if self.by_lidar:
            uv, z = points
            uv = (uv + 0.5 - [left, top]) * [columns / width, rows / height] - 0.5
            inside = np.flatnonzero((uv > -0.5).all(1) & (uv[:, 0] < columns - 0.5) & (uv[:, 1] < rows - 0.5))
            chosen = rng.choice(inside, min(POINTS, len(inside)), replace=False)
            lesson["uv"], lesson["log_inverse"] = np.zeros((POINTS, 2), np.float32), np.zeros(POINTS, np.float32)
            lesson["weight"] = np.zeros(POINTS, np.float32)
            lesson["uv"][:len(chosen)], lesson["log_inverse"][:len(chosen)] = uv[chosen], -np.log(z[chosen])
            lesson["weight"][:len(chosen)] = 1
        if self.by_stereo:
            sharp = (SHARPER * columns, SHARPER * rows)
            for name, whole in (("left", image), ("right", right)):
                lesson[name] = cv2.resize(whole[part], sharp, interpolation=cv2.INTER_AREA).astype(np.float32)[None] / 255
            lesson["focal_baseline"] = np.float32(recording.camera.fx * SHARPER * columns / width * recording.baseline_m)
        elif rng.random() < 0.5:  # mirrored, left would be right
            lesson["plain"] = small = np.ascontiguousarray(small[:, ::-1])
            lesson["uv"][:, 0] = columns - 1 - lesson["uv"][:, 0]
        varied = data.seen_by_some_camera(rng, small, np.ones(small.shape, np.uint16)) if rng.random() < 0.5 else small
        lesson["image"] = varied[None].astype(np.float32) / 255
        lesson["plain"] = lesson["plain"][None].astype(np.float32) / 255
        return lesson

    def batch(self, seed, step, count):
        rng = np.random.default_rng((seed, step))
        lessons = [self.one(rng, index) for index in rng.integers(0, len(self.frames), count)]
        return {name: torch.from_numpy(np.stack([lesson[name] for lesson in lessons])) for name in lessons[0]}


def split(recordings, rule):
    """Frames to learn from, and frames held out. Neighbours of a video are nearly the same frame, so by default the last
    quarter is held out, and a twentieth before it is left out of both."""
    learned, held_out = [], []
    for recording in recordings:
        frames = recording.frames
        if rule in ("odd", "even"):
            parity = int(rule == "odd")
            learned.append((recording, frames[1 - parity::2])), held_out.append((recording, frames[parity::2]))
        else:
            end = math.floor(0.75 * len(frames))
            learned.append((recording, frames[:math.floor(0.7 * len(frames))])), held_out.append((recording, frames[end:]))
    for name, part, least in (("to learn from", learned, 4), ("held out", held_out, 4)):
        if sum(len(frames) for _, frames in part) < least:
            raise Refused(f"fewer than {least} frames are {name}: give longer recordings")
    return learned, held_out


# --- validation ---

def agreement(network, recordings):
    """For each frame, Spearman's rank correlation of inverse depth with the LiDAR, at the points that the camera sees. A
    point on a pixel that the network takes for sky counts as the farthest: depth must not gain by leaving pixels out."""
    scores = []
    for recording, frames in recordings:
        rows, columns = input_size(recording.camera)
        for frame in frames:
            image = recording.image(frame)
            small = cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA)
            with torch.no_grad():
                output = network(torch.from_numpy(small[None, None].astype(np.float32) / 255))[0, 0].numpy()
            output = cv2.resize(output, image.shape[::-1], interpolation=cv2.INTER_LINEAR)
            uv, z = visible_points(recording, frame)
            column, row = np.rint(uv).astype(int).T
            scores.append(spearman(np.maximum(output[row, column], supervision.LOG_SKY), -z))
    return np.array(scores)


def chance_of(gain):
    """That frames gain so much on average when each gains or loses by chance: Fisher's sign-flip test, one-sided. A frame
    that gains very much makes it no worse, as it would a test by the standard error."""
    signs = np.random.default_rng(1).choice([-1.0, 1.0], (20000, len(gain)))
    return float(np.mean(signs @ gain >= gain.sum() - 1e-12))


# --- training ---

def fingerprint(options, learned):
    """Of what the weights depend on. A checkpoint of another one is not gone on with."""
    told = {name: str(value) for name, value in vars(options).items() if name not in ("out", "name", "every")}
    told["start"] = hashlib.sha256(options.start.read_bytes()).hexdigest()
    told["frames"] = [frame.name for _, frames in learned for frame in frames]
    return hashlib.sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()


def loss_of(network, before, batch, options):
    output = network(batch["image"])
    with torch.no_grad():
        remembered = before(batch["plain"])
    loss = options.memory * supervision.memory_loss(output, remembered)
    if "uv" in batch:
        loss = loss + supervision.lidar_loss(output, batch["uv"], batch["log_inverse"], batch["weight"])
    if "left" in batch:
        loss = loss + 3 * supervision.stereo_loss(output, batch["left"], batch["right"], batch["focal_baseline"])
    return loss


def rate_at(step, options):
    """Up over the first fifth of the steps, at most 20; down to nothing over the last 70 %."""
    return options.rate * min(1.0, (step + 1) / min(20, 0.2 * options.steps), (options.steps - step) / (0.7 * options.steps))


def save(path, state):
    temporary = path.with_suffix(".tmp")
    torch.save(state, temporary)
    temporary.replace(path)


def train(before, learned, options):
    network = copy.deepcopy(before).train()
    smooth = copy.deepcopy(before)
    if options.layers == "decoder":  # what few frames teach the rest of the encoder holds for no other frame
        network.down[:4].requires_grad_(False)
    taught = [weight for weight in network.parameters() if weight.requires_grad]
    optimizer = torch.optim.AdamW(taught, weight_decay=0.01)
    checkpoint, mark, first = options.out / "checkpoint.pt", fingerprint(options, learned), 0
    if checkpoint.exists():
        state = torch.load(checkpoint)
        if state["mark"] != mark:
            raise Refused(f"{checkpoint} is of other options, frames or weights: give another --out, or remove it")
        network.load_state_dict(state["network"]), smooth.load_state_dict(state["smooth"])
        optimizer.load_state_dict(state["optimizer"])
        first = state["step"]
        print(f"goes on at step {first}", flush=True)
    lessons = Lessons(learned, options.supervision)
    begin = time.monotonic()
    for step in range(first, options.steps):
        for group in optimizer.param_groups:
            group["lr"] = rate_at(step, options)
        loss = loss_of(network, before, lessons.batch(options.seed, step, options.batch), options)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(taught, 1.0)
        optimizer.step()
        with torch.no_grad():
            keep = min(0.98, (step + 1) / (step + 10))
            for ours, theirs in zip(smooth.parameters(), network.parameters()):
                ours.lerp_(theirs, 1 - keep)
        if (step + 1) % options.every == 0 or step + 1 == options.steps:
            save(checkpoint, {"mark": mark, "step": step + 1, "network": network.state_dict(),
                              "smooth": smooth.state_dict(), "optimizer": optimizer.state_dict()})
            spent = time.monotonic() - begin
            left = spent / (step + 1 - first) * (options.steps - step - 1)
            print(f"step {step + 1} of {options.steps}, loss {loss.item():.4f}, {spent:.0f} s, about {left:.0f} s left",
                  flush=True)
    return smooth


def adapt(options):
    torch.manual_seed(options.seed)
    torch.use_deterministic_algorithms(True)
    torch.set_num_threads(options.threads)
    cv2.setNumThreads(1)
    recordings = [open_recording(path) for path in options.recordings]
    if options.supervision != "lidar":
        for path, recording in zip(options.recordings, recordings):
            if recording.baseline_m is None:
                raise Refused(f"{path} has no right images, or no baseline: use --supervision lidar")
    if len({input_size(recording.camera) for recording in recordings}) > 1:
        raise Refused("the recordings have images of different aspect ratios: adapt to one camera at a time")
    learned, held_out = split(recordings, options.held_out)
    if options.steps is None:
        options.steps = max(20, PASSES * sum(len(frames) for _, frames in learned) // options.batch)
    before, golden_image = load(options.start)
    options.out.mkdir(parents=True, exist_ok=True)
    count = [sum(len(frames) for _, frames in part) for part in (learned, held_out)]
    scores_before = agreement(before, held_out)
    print(f"{count[0]} frames to learn from, {count[1]} held out, whose median rank correlation is "
          f"{np.median(scores_before):.3f}", flush=True)
    adapted = train(before, learned, options)
    scores_after = agreement(adapted, held_out)
    gain = scores_after - scores_before
    better = gain.mean() > 0 and chance_of(gain) < 0.05
    result = {"frames": count, "before": scores_before.round(4).tolist(), "after": scores_after.round(4).tolist(),
              "mean_gain": round(float(gain.mean()), 4), "chance": round(chance_of(gain), 4), "better": bool(better)}
    (options.out / "result.json").write_text(json.dumps(result, indent=1) + "\n")
    print(f"held-out frames: median {np.median(scores_before):.3f} before, {np.median(scores_after):.3f} after; mean gain "
          f"{gain.mean():+.4f}, by chance in {100 * chance_of(gain):.1f} %")
    if not better:
        raise Refused("the network is not better on the held-out frames by more than chance (5 %), so nothing is exported: "
                      "give more frames of more places, or another --supervision; if it fell clearly, is the extrinsic right?")
    export.export(adapted.eval(), golden_image, options.out, options.name,
                  f"{options.start.stem}, adapted to one camera by tools/train/adapt.py ({options.supervision}).")
    print(f"{options.out / options.name}.yaml is written; check it: calibctl check-model {options.out / options.name}.yaml "
          f"--recording {options.recordings[0]}")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=pathlib.Path, help="folder for the network, checkpoint.pt and result.json")
    parser.add_argument("--recordings", type=pathlib.Path, nargs="+", required=True,
                        help="DATE/DRIVE of KITTI raw, or YAML files of lists (rectified cameras), all of one camera")
    parser.add_argument("--supervision", choices=["lidar", "stereo", "both"], default="lidar")
    parser.add_argument("--held-out", choices=["last", "odd", "even"], default="last",
                        help="the last quarter of each recording, or every second frame where they are separate scenes")
    parser.add_argument("--start", type=pathlib.Path, default=BOX,
                        help="descriptor of a network of tools/train, or checkpoint.pt of train.py")
    parser.add_argument("--name", default="street-adapted", help="of the files that are written")
    parser.add_argument("--steps", type=int, help=f"default: until each frame was seen {PASSES} times, at least 20")
    parser.add_argument("--layers", choices=["decoder", "all"], default="decoder",
                        help="what learns: the decoder and the last part of the encoder, or, from thousands of frames, all")
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--rate", type=float, default=3e-4)
    parser.add_argument("--memory", type=float, default=0.15, help="weight of staying what the network was")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--every", type=int, default=50, help="steps between two checkpoints")
    options = parser.parse_args()
    try:
        adapt(options)
    except (Refused, RecordingError, OSError, ValueError) as error:
        print(f"adapt.py: {error}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
