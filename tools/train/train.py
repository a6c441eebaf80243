"""Trains the network on packed frames. The same command gives the same weights on the same machine."""

import argparse
import copy
import json
import pathlib
import queue
import threading
import time

import cv2
import numpy as np
import torch

import data
from evaluate import simulated_scores
from network import DepthNetwork

WARM_UP = 200  # steps


def learning_rate(step, options):
    """Up at the beginning; down to nothing over the last share of the steps."""
    fall = max(1.0, options.decay * options.steps)
    return options.rate * min(1.0, (step + 1) / WARM_UP, (options.steps - step) / fall)


def loss_of(output, target):
    """How wrong depth is, whatever its scale, and how wrong its edges are. Both: logarithms of inverse depth."""
    sky = target <= data.SKY_LOG + 1e-3
    error = output - target
    # An image tells the scale from the camera's height at best: most of the mean error is forgiven.
    solid = (~sky).float()
    mean = (error * solid).sum((1, 2, 3), keepdim=True) / solid.sum((1, 2, 3), keepdim=True).clamp(min=1)
    error = error - 0.9 * mean
    error = torch.where(sky, error.clamp(min=-0.3), error)  # no sky is too far
    value = error.abs().mean()
    # Weighs edges: what is smooth in truth shall be smooth, and what jumps shall jump there, not a little beside.
    slope, scaled = 0.0, error
    for _ in range(4):
        across, down = scaled[..., 1:] - scaled[..., :-1], scaled[..., 1:, :] - scaled[..., :-1, :]
        slope = slope + across.abs().mean() + down.abs().mean()
        scaled = scaled[..., ::2, ::2]
    return value + 0.5 * slope


def size_of(options, step):
    """Rows, columns; sizes take turns."""
    columns, rows = map(int, options.size[step % len(options.size)].split("x"))
    return rows, columns


def batches(frames, options):
    """Made beside the training, in order."""
    ready = queue.Queue(maxsize=6)

    def make():
        for step in range(options.steps):
            ready.put(data.batch(frames, options.seed, step, options.batch, size_of(options, step)))

    threading.Thread(target=make, daemon=True).start()
    for step in range(options.steps):
        yield step, ready.get()


def train(options):
    torch.manual_seed(options.seed)
    torch.use_deterministic_algorithms(True)
    torch.set_num_threads(options.threads)
    torch.set_num_interop_threads(1)
    cv2.setNumThreads(1)
    frames, held_out = data.Frames(options.frames), data.Frames([options.held_out])
    network = DepthNetwork().to(memory_format=torch.channels_last)
    smooth = copy.deepcopy(network).eval()  # its weights are the running mean of the others
    decayed = [p for p in network.parameters() if p.dim() > 1]
    plain = [p for p in network.parameters() if p.dim() <= 1]
    optimizer = torch.optim.AdamW([{"params": decayed, "weight_decay": 0.02}, {"params": plain, "weight_decay": 0.0}])
    if options.start:
        state = torch.load(options.start)
        network.load_state_dict(state["network"]), smooth.load_state_dict(state["smooth"])
        optimizer.load_state_dict(state["optimizer"])
    options.out.mkdir(parents=True, exist_ok=True)
    curve = open(options.out / "curve.jsonl", "a", buffering=1)
    begin, mean_loss = time.monotonic(), None
    for step, (images, targets) in batches(frames, options):
        rate = learning_rate(step, options)
        for group in optimizer.param_groups:
            group["lr"] = rate
        images = torch.from_numpy(images).to(memory_format=torch.channels_last)
        with torch.autocast("cpu", torch.bfloat16):
            output = network(images)
        loss = loss_of(output.float(), torch.from_numpy(targets))
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        mean_loss = loss.item() if mean_loss is None else 0.99 * mean_loss + 0.01 * loss.item()
        with torch.no_grad():
            keep = min(0.998, (step + 1) / (step + 10))
            for ours, theirs in zip(smooth.state_dict().values(), network.state_dict().values()):
                if ours.dtype.is_floating_point:
                    ours.lerp_(theirs, 1 - keep)
                else:
                    ours.copy_(theirs)
        if (step + 1) % options.every == 0 or step + 1 == options.steps:
            scores = simulated_scores(smooth, held_out, size_of(options, 0))
            curve.write(json.dumps({"step": step + 1, "loss": round(mean_loss, 4), "rate": rate,
                                    "seconds": round(time.monotonic() - begin),
                                    "spearman_median": round(float(np.median(scores)), 4),
                                    "spearman_low": round(float(np.quantile(scores, 0.1)), 4)}) + "\n")
            state = {"step": step + 1, "network": network.state_dict(), "smooth": smooth.state_dict(),
                     "optimizer": optimizer.state_dict()}
            torch.save(state, options.out / "checkpoint.tmp")
            (options.out / "checkpoint.tmp").replace(options.out / "checkpoint.pt")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=pathlib.Path, help="folder for checkpoint.pt and curve.jsonl")
    parser.add_argument("--frames", type=pathlib.Path, nargs="+", required=True, help="folders that data.py packed")
    parser.add_argument("--held-out", type=pathlib.Path, required=True, help="another one, of other seeds")
    parser.add_argument("--steps", type=int, default=16000)
    parser.add_argument("--batch", type=int, default=16)
    parser.add_argument("--rate", type=float, default=2e-3)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--every", type=int, default=500, help="steps between two looks at the held-out frames")
    parser.add_argument("--size", nargs="+", default=["320x96"],
                        help="of what the network sees, in turns; a smaller one is quicker to begin with")
    parser.add_argument("--decay", type=float, default=0.4, help="share of the steps over which the rate falls to 0")
    parser.add_argument("--start", type=pathlib.Path, help="checkpoint.pt of another run to go on from")
    train(parser.parse_args())


if __name__ == "__main__":
    main()
