"""How well depth is ranked: Spearman's correlation of prediction and truth over the pixels of a frame."""

import argparse
import json
import pathlib

import cv2
import numpy as np
import torch

import data


def ranks(values):
    """Mean rank of equal values."""
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    ends = np.cumsum(counts)
    return (ends - (counts + 1) / 2)[inverse]


def spearman(a, b):
    return float(np.corrcoef(ranks(a), ranks(b))[0, 1])


def predict(network, image, size):
    """Logarithm of inverse depth in the image's own size."""
    small = cv2.resize(image, size[::-1], interpolation=cv2.INTER_AREA)
    with torch.no_grad():
        output = network(torch.from_numpy(small[None, None].astype(np.float32) / 255))
    return cv2.resize(output[0, 0].numpy(), image.shape[::-1], interpolation=cv2.INTER_LINEAR)


def simulated_scores(network, frames, size=data.SIZE, count=150):
    """Of what has depth in the middle 3.3 : 1 of held-out frames."""
    scores = []
    rows = round(data.WIDTH * size[0] / size[1])
    top = (data.HEIGHT - rows) // 2
    for index in range(min(count, len(frames))):
        image, depth = (np.ascontiguousarray(part[top:top + rows]) for part in frames[index])
        solid = depth[::2, ::2] > 0
        output = predict(network, image, size)[::2, ::2]
        if solid.mean() > 0.1:
            scores.append(spearman(output[solid], -depth[::2, ::2][solid].astype(np.float32)))
    return scores


def recorded_scores(network, drive, size, dump=None):
    """Against `depth/stereo_net` of a drive in KITTI's layout: where both have depth, and also where the network sees
    sky, of which the reference has the depth wrong. `dump`: folder for the inverse depths, as .npy."""
    scores = {}
    for file in sorted((drive / "image_02" / "data").glob("*.png")):
        truth = cv2.imread(str(drive / "depth" / "stereo_net" / file.name), cv2.IMREAD_UNCHANGED)
        image = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
        output = predict(network, image, size)
        if dump:
            dump.mkdir(parents=True, exist_ok=True)
            inverse = np.where(output > np.log(data.SKY), np.exp(output), 0)  # 0: no depth
            np.save(dump / (file.stem + ".npy"), inverse.astype(np.float32))
        everywhere = truth > 0
        seen = everywhere & (output > np.log(data.SKY))
        scores[file.stem] = {"seen": spearman(output[seen], truth[seen].astype(np.float32)),
                             "seen_share": float(seen.mean()),
                             "with_sky": spearman(output[everywhere], truth[everywhere].astype(np.float32))}
    return scores


def main():
    from network import DepthNetwork
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkpoint", type=pathlib.Path)
    parser.add_argument("--held-out", type=pathlib.Path)
    parser.add_argument("--drive", type=pathlib.Path)
    parser.add_argument("--dump", type=pathlib.Path)
    parser.add_argument("--size", default="320x96")
    options = parser.parse_args()
    columns, rows = map(int, options.size.split("x"))
    network = DepthNetwork().eval()
    network.load_state_dict(torch.load(options.checkpoint)["smooth"])
    if options.held_out:
        scores = simulated_scores(network, data.Frames([options.held_out]), (rows, columns))
        print(json.dumps({"simulated_median": np.median(scores), "simulated_low": np.quantile(scores, 0.1)}))
    if options.drive:
        scores = recorded_scores(network, options.drive, (rows, columns), options.dump)
        keys = ("seen", "seen_share", "with_sky")
        print(json.dumps({key: float(np.median([frame[key] for frame in scores.values()])) for key in keys}))
        for name, frame in scores.items():
            print(name, {key: round(value, 3) for key, value in frame.items()})


if __name__ == "__main__":
    main()
