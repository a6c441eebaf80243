"""Writes small ONNX depth networks into a folder: one for each convention that a descriptor can express, and broken ones.

    make_depth_models.py FOLDER

What a convention's network computes is known: inverse depth q = (0.5 red + 0.3 green + 0.2 blue + 5) / 260 in 1/m. Each
undoes the preprocessing of its convention and puts q into its own terms, so all of them see the same depth.
"""

import hashlib
import pathlib
import sys

import numpy as np
import onnx
import PIL.Image
from onnx import TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

WEIGHTS = np.array([0.5, 0.3, 0.2])  # of red, green and blue
IMAGENET = {"scale": 1 / 255, "mean": [0.485, 0.456, 0.406], "std": [0.229, 0.224, 0.225]}
FOCAL_PX, IMAGE = 200.0, (320, 96)  # of the camera that the tests look through


class Graph:
    """A chain of nodes from `image` on; `last` is the name of the newest value."""

    def __init__(self):
        self.nodes, self.constants, self.last = [], [], "image"

    def add(self, operator, *constants, domain="", **attributes):
        names = [self.last]
        for value in constants:
            names.append(f"constant{len(self.constants)}")
            self.constants.append(numpy_helper.from_array(np.asarray(value), names[-1]))
        self.last = f"{operator}{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, names, [self.last], domain=domain, **attributes))
        return self

    def model(self, input_shape, output_shape, kind=TensorProto.FLOAT, domains=()):
        self.nodes[-1].output[0] = "depth"
        graph = helper.make_graph(self.nodes, "depth", [helper.make_tensor_value_info("image", kind, input_shape)],
                                  [helper.make_tensor_value_info("depth", TensorProto.FLOAT, output_shape)], self.constants)
        opsets = [helper.make_opsetid("", 17)] + [helper.make_opsetid(domain, 1) for domain in domains]
        # An IR that every ONNX Runtime of the supported distributions reads.
        return helper.make_model(graph, ir_version=8, opset_imports=opsets)


def f32(*values):
    return np.array(values, dtype=np.float32)


def floats(values):
    return np.asarray(values, dtype=np.float32)


def inverse_depth(order, graph=None, scale=1.0, mean=None, std=None, inside=False):
    """From an NCHW value to q, N x 1 x H x W. `inside`: the network normalises by itself."""
    weights = {"rgb": WEIGHTS, "bgr": WEIGHTS[::-1], "grey": np.array([1.0])}[order]
    mean = np.zeros(len(weights)) if mean is None else np.array(mean)
    std = np.ones(len(weights)) if std is None else np.array(std)
    graph = graph or Graph()
    if inside:
        graph.add("Mul", f32(scale)).add("Sub", floats(mean.reshape(1, -1, 1, 1))).add("Div", floats(std.reshape(1, -1, 1, 1)))
    kernel = weights * std / (scale * 260)
    bias = (weights * mean / scale).sum() / 260 + 5 / 260
    return graph.add("Conv", floats(kernel.reshape(1, -1, 1, 1)), f32(bias))


def write(folder, name, model, text, golden=None):
    path = folder / f"{name}.onnx"
    path.write_bytes(model.SerializeToString())
    describe(folder, name, text, golden)


def describe(folder, name, text, golden=None, of=None):
    digest = hashlib.sha256((folder / f"{of or name}.onnx").read_bytes()).hexdigest()
    pair = f"golden: {{image: {golden}.png, output: {golden}.f32, tolerance: 0.001}}\n" if golden else ""
    (folder / f"{name}.yaml").write_text(f"file: {of or name}.onnx\nsha256: {digest}\n{text}{pair}")


def yaml(entries):
    return "{" + ", ".join(f"{key}: {value}" for key, value in entries.items()) + "}"


def text_of(input_entries, output_entries):
    scale = input_entries["scale"]
    entries = {"name": "image", **input_entries, "scale": "1/255" if scale == 1 / 255 else scale}
    return f"input: {yaml(entries)}\noutput: {yaml({'name': 'depth', **output_entries})}\n"


def write_golden(folder, name, model, entries, seed):
    """A picture of the network's own size and what the reference implementation of ONNX makes of it."""
    width, height = entries["size"]
    pixels = np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)
    if entries["channel_order"] == "grey":
        pixels[...] = pixels[..., :1]
    PIL.Image.fromarray(pixels).save(folder / f"{name}.png")
    channels = {"rgb": pixels, "bgr": pixels[..., ::-1], "grey": pixels[..., :1]}[entries["channel_order"]]
    tensor = (channels * entries["scale"] - np.array(entries.get("mean", [0]))) / np.array(entries.get("std", [1]))
    tensor = tensor if entries["layout"] == "nhwc" else tensor.transpose(2, 0, 1)
    (depth,) = ReferenceEvaluator(model).run(None, {"image": floats(tensor[None])})
    floats(depth).astype("<f4").tofile(folder / f"{name}.f32")


def rank3(graph):
    return graph.add("Squeeze", np.array([1], dtype=np.int64))


def conventions():
    """Name -> graph, shapes of input and output, descriptor entries."""
    image, nominal = ["n", 3, "h", "w"], {"layout": "nchw", "channel_order": "rgb"}
    half = {"scale": 1 / 255, "mean": [0.5] * 3, "std": [0.5] * 3}
    metric = {"scale": 1, "mean": [123.675, 116.28, 103.53], "std": [58.395, 57.12, 57.375]}
    a, b = 9.99, 0.01
    # Metric3D's focal length: of the image as it lies in the input.
    letterbox = (256, 128)
    to_canonical = 1000.0 / (FOCAL_PX * letterbox[0] / IMAGE[0])
    yield ("depth_anything", rank3(inverse_depth("rgb", **IMAGENET)), image, ["n", "h", "w"],
           {**nominal, "size": (168, 168), "keep_aspect": "lower_bound", "multiple_of": 14, "interpolation": "cubic", **IMAGENET},
           {"semantics": "inverse_relative"})
    yield ("midas_small", rank3(inverse_depth("rgb", **IMAGENET, inside=True)), [1, 3, 256, 256], [1, 256, 256],
           {**nominal, "size": (256, 256), "scale": 1}, {"semantics": "inverse_relative"})
    yield ("dpt", inverse_depth("rgb", **half), image, ["n", 1, "h", "w"],
           {**nominal, "size": (384, 384), "keep_aspect": "upper_bound", "multiple_of": 32, "interpolation": "cubic", **half},
           {"semantics": "inverse_relative"})
    yield ("monodepth2", inverse_depth("rgb", scale=1 / 255).add("Sub", f32(b)).add("Div", f32(a)), [1, 3, 192, 640],
           [1, 1, 192, 640], {**nominal, "size": (640, 192), "scale": 1 / 255, "interpolation": "linear"},
           {"semantics": "disparity_sigmoid", "a": a, "b": b})
    yield ("metric3d", inverse_depth("rgb", **metric).add("Reciprocal").add("Mul", f32(to_canonical)), [1, 3, 128, 256],
           [1, 1, 128, 256], {**nominal, "size": letterbox, "letterbox": "centre", **metric},
           {"semantics": "depth_metric", "canonical_focal_px": 1000, "valid_range": [0.3, 300]})
    yield ("unidepth", inverse_depth("rgb", **IMAGENET).add("Reciprocal"), image, ["n", 1, "h", "w"],
           {**nominal, "size": (224, 224), "letterbox": "top_left", "fill": [0, 0, 0], **IMAGENET},
           {"semantics": "depth_metric", "along": "ray"})
    yield ("channels_last", channels_last(), [1, "h", "w", 3], [1, "h", "w", 1],
           {"layout": "nhwc", "channel_order": "bgr", "size": IMAGE, "scale": 1 / 255, "interpolation": "lanczos"},
           {"semantics": "depth_relative"})
    yield ("grey", inverse_depth("grey", scale=1 / 255), ["n", 1, "h", "w"], ["n", 1, "h", "w"],
           {**nominal, "channel_order": "grey", "size": (640, 192), "scale": 1 / 255}, {"semantics": "disparity"})
    pooled = inverse_depth("rgb").add("AveragePool", kernel_shape=[2, 2], strides=[2, 2])
    yield ("fixed_output", pooled, image, ["n", 1, "h2", "w2"], {**nominal, "size": IMAGE, "scale": 1},
           {"semantics": "disparity"})


def channels_last():
    graph = inverse_depth("bgr", Graph().add("Transpose", perm=[0, 3, 1, 2]), scale=1 / 255)
    return graph.add("Reciprocal").add("Transpose", perm=[0, 2, 3, 1])


def write_conventions(folder):
    for seed, (name, graph, input_shape, output_shape, inputs, outputs) in enumerate(conventions()):
        model = graph.model(input_shape, output_shape)
        onnx.checker.check_model(model, full_check=True)
        write_golden(folder, name, model, inputs, seed)
        write(folder, name, model, text_of({**inputs, "size": list(inputs["size"])}, outputs), golden=name)


def write_broken(folder):
    shape, entries = [1, 3, 96, 320], {"layout": "nchw", "channel_order": "rgb", "size": [320, 96], "scale": 1}
    output = {"semantics": "inverse_relative"}
    text, map_shape = text_of(entries, output), [1, 1, 96, 320]
    good = inverse_depth("rgb").model(shape, map_shape)
    write(folder, "good", good, text)
    describe(folder, "other_input", text.replace("name: image", "name: picture"), of="good")
    describe(folder, "other_output", text.replace("name: depth", "name: disparity"), of="good")
    describe(folder, "other_size", text.replace("320, 96", "640, 192"), of="good")
    describe(folder, "other_layout", text.replace("nchw", "nhwc"), of="good")
    describe(folder, "other_channels", text.replace("rgb", "grey"), of="good")
    describe(folder, "not_there", text, of="good")
    (folder / "not_there.yaml").write_text((folder / "not_there.yaml").read_text().replace("good.onnx", "nowhere.onnx"))
    write(folder, "unknown_operator", Graph().add("Foresee", domain="future").model(shape, map_shape, domains=["future"]), text)
    write(folder, "future_ir", set_ir(inverse_depth("rgb").model(shape, map_shape), 99), text)
    write(folder, "bytes", Graph().add("Cast", to=TensorProto.FLOAT).model(shape, shape, TensorProto.UINT8), text)
    write(folder, "rank_three_input", Graph().add("Relu").model([3, 96, 320], [3, 96, 320]), text)
    write(folder, "three_maps", Graph().add("Relu").model(shape, shape), text)
    write(folder, "flat", inverse_depth("rgb").add("Flatten").model(shape, [1, 96 * 320]), text)
    write(folder, "not_a_number", inverse_depth("rgb").add("Neg").add("Log").model(shape, map_shape), text)
    # Where q is below one half: negative, and infinite.
    write(folder, "negative", inverse_depth("rgb").add("Sub", f32(0.5)).model(shape, map_shape), text)
    write(folder, "infinite", inverse_depth("rgb").add("Sub", f32(0.5)).add("Clip", np.float32(0), np.float32(9)).add("Reciprocal")
          .model(shape, map_shape), text)
    two = inverse_depth("rgb").model(shape, map_shape)
    two.graph.input.append(helper.make_tensor_value_info("intrinsics", TensorProto.FLOAT, [1, 3, 3]))
    write(folder, "two_inputs", two, text)
    (folder / "text.onnx").write_text("a network, in words\n")
    describe(folder, "text", text)
    (folder / "cut.onnx").write_bytes(good.SerializeToString()[:-7])
    describe(folder, "cut", text)
    write_external(folder, shape, map_shape, text)


def set_ir(model, version):
    model.ir_version = version
    return model


def write_external(folder, shape, map_shape, text):
    """Weights in another file: of the graph itself, of a constant, and of the branch of a condition."""
    external = folder / "external.onnx"
    onnx.save(inverse_depth("rgb").model(shape, map_shape), external, save_as_external_data=True,
              location="external.bin", size_threshold=0)
    assert (folder / "external.bin").stat().st_size > 0
    describe(folder, "external", text)
    # The way back: the location is written down, and is inside.
    write(folder, "internal_again", onnx.load(external), text)

    tensor = onnx.load(external, load_external_data=False).graph.initializer[0]
    constant = helper.make_node("Constant", [], ["kernel"], value=tensor)
    model = inverse_depth("rgb").model(shape, map_shape)
    del model.graph.initializer[0]
    model.graph.node[0].input[1] = "kernel"
    model.graph.node.insert(0, constant)
    write(folder, "external_constant", model, text)

    branch = helper.make_graph([constant], "branch", [], [helper.make_tensor_value_info("kernel", TensorProto.FLOAT, [1, 3, 1, 1])])
    model.graph.initializer.append(numpy_helper.from_array(np.array(True), "yes"))
    model.graph.node[0].CopyFrom(helper.make_node("If", ["yes"], ["kernel"], then_branch=branch, else_branch=branch))
    write(folder, "external_branch", model, text)


def write_bench(folder):
    """An encoder and decoder with random weights, of the size of the smaller networks there are: 1.6 M parameters."""
    random = np.random.default_rng(1)
    graph = Graph()

    def convolve(inputs, outputs, stride=1):
        spread = np.sqrt(2 / (9 * inputs))
        graph.add("Conv", floats(random.normal(0, spread, (outputs, inputs, 3, 3))), np.zeros(outputs, np.float32),
                  strides=[stride, stride], pads=[1, 1, 1, 1]).add("Relu")

    for inputs, outputs, stride in [(3, 32, 2), (32, 64, 2), (64, 128, 2), (128, 128, 1), (128, 128, 1), (128, 256, 2),
                                    (256, 256, 1), (256, 64, 1)]:
        convolve(inputs, outputs, stride)
    for inputs, outputs in [(64, 64), (64, 32), (32, 16), (16, 8)]:
        twice = graph.last
        graph.nodes.append(helper.make_node("Resize", [twice, "", "scales"], [f"{twice}_twice"], mode="nearest"))
        graph.last = f"{twice}_twice"
        convolve(inputs, outputs)
    graph.constants.append(numpy_helper.from_array(f32(1, 1, 2, 2), "scales"))
    graph.add("Conv", floats(random.normal(0, 0.1, (1, 8, 1, 1))), f32(0)).add("Sigmoid")
    model = graph.model([1, 3, "h", "w"], [1, 1, "h", "w"])
    for width, height in (320, 96), (640, 192):
        entries = {"layout": "nchw", "channel_order": "rgb", "size": [width, height], **IMAGENET}
        write(folder, f"bench_{width}x{height}", model, text_of(entries, {"semantics": "disparity_sigmoid", "a": 9.99, "b": 0.01}))


def main():
    folder = pathlib.Path(sys.argv[1])
    folder.mkdir(parents=True, exist_ok=True)
    write_conventions(folder)
    write_broken(folder)
    write_bench(folder)


if __name__ == "__main__":
    main()
