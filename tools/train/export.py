"""From a checkpoint to what calibd reads: the ONNX file, its descriptor and the golden pair."""

import argparse
import hashlib
import pathlib

import cv2
import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper

import data
from network import DepthNetwork, InverseDepth, convolutions, without_batch_norm

TITLE = "A small depth network for streets, trained on simulated pictures alone (tools/train)."
DESCRIPTOR = """\
# {title}
file: {name}.onnx
sha256: {sha256}
input:
  name: image
  layout: nchw
  channel_order: grey
  size: [320, 320]
  keep_aspect: upper_bound
  multiple_of: 32
  interpolation: area
  scale: 1/255
output:
  name: inverse_depth
  semantics: inverse_relative
  valid_range: [{sky}, 10]   # what is below is sky
golden:
  image: {name}-golden.png
  output: {name}-golden.f32
"""


def halve_weights(model):
    """Stores large weights as 16-bit floats, which ONNX Runtime widens once, when it loads them."""
    nodes = []
    for weight in list(model.graph.initializer):
        if weight.data_type != TensorProto.FLOAT or np.prod(weight.dims) < 256:
            continue
        values = numpy_helper.to_array(weight).astype(np.float16)
        name = weight.name + "_16"
        model.graph.initializer.remove(weight)
        model.graph.initializer.append(numpy_helper.from_array(values, name))
        nodes.append(helper.make_node("Cast", [name], [weight.name], to=TensorProto.FLOAT))
    for node in reversed(nodes):
        model.graph.node.insert(0, node)


def export(network, golden_image, folder, name, title=TITLE):
    """Writes NAME.onnx, NAME.yaml and the golden pair into `folder`."""
    model = InverseDepth(network).eval()
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.onnx"
    torch.onnx.export(model, torch.zeros(1, 1, 96, 320), path, input_names=["image"], output_names=["inverse_depth"],
                      dynamic_axes={"image": {2: "rows", 3: "columns"}, "inverse_depth": {2: "rows", 3: "columns"}},
                      opset_version=17)
    graph = onnx.load(path)
    halve_weights(graph)
    graph.producer_name, graph.producer_version, graph.doc_string = "calibd tools/train", "", ""
    onnx.checker.check_model(graph, full_check=True)
    path.write_bytes(graph.SerializeToString(deterministic=True))

    image = cv2.imread(str(golden_image), cv2.IMREAD_GRAYSCALE)
    rows = image.shape[0] * 320 // image.shape[1]
    assert rows % 32 == 0, "a golden image is resized by one factor"
    cv2.imwrite(str(folder / f"{name}-golden.png"), image)
    small = cv2.resize(image, (320, rows), interpolation=cv2.INTER_AREA)
    with torch.no_grad():  # 32-bit weights: those that are stored change it far less than the descriptor's tolerance
        output = model(torch.from_numpy(small[None, None].astype(np.float32) / 255))
    (folder / f"{name}-golden.f32").write_bytes(output.numpy().astype("<f4").tobytes())
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    (folder / f"{name}.yaml").write_text(DESCRIPTOR.format(title=title, name=name, sha256=sha256, sky=data.SKY))


def load_onnx(path):
    """The network of a file that `export` wrote, without batch normalisation."""
    graph = onnx.load(path).graph
    held = {tensor.name: numpy_helper.to_array(tensor).astype(np.float32) for tensor in graph.initializer}
    held |= {node.output[0]: held[node.input[0]] for node in graph.node if node.op_type == "Cast" and node.input[0] in held}
    weights = [[held[name] for name in node.input[1:]] for node in graph.node if node.op_type == "Conv"]
    try:
        # The first convolution of each of the five parts of the encoder tells its width.
        network = without_batch_norm(DepthNetwork(tuple(len(weights[i][1]) for i in (0, 2, 5, 10, 15))))
        layers = convolutions(network)
        if len(layers) != len(weights):
            raise ValueError(f"{len(weights)} convolutions instead of {len(layers)}")
        for layer, (weight, bias) in zip(layers, weights):
            if layer.weight.shape != weight.shape:
                raise ValueError(f"a convolution of {weight.shape} instead of {tuple(layer.weight.shape)}")
            layer.weight.data, layer.bias.data = torch.from_numpy(weight.copy()), torch.from_numpy(bias.copy())
    except (IndexError, ValueError) as error:
        raise ValueError(f"{path} is not a network of tools/train: {error}") from error
    return network.eval()


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("checkpoint", type=pathlib.Path)
    parser.add_argument("golden_image", type=pathlib.Path, help="a picture of 640 x 192 pixels")
    parser.add_argument("--folder", type=pathlib.Path, default=pathlib.Path(__file__).parents[2] / "libcalib/models")
    parser.add_argument("--name", default="street-small")
    options = parser.parse_args()
    network = DepthNetwork().eval()
    network.load_state_dict(torch.load(options.checkpoint)["smooth"])
    export(network, options.golden_image, options.folder, options.name)


if __name__ == "__main__":
    main()
