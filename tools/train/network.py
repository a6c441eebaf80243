"""A small encoder and decoder of 3x3 convolutions: one grey image in, relative inverse depth of the same size out."""

import torch
from torch import nn
from torch.nn import functional


def conv(inputs, outputs, stride=1):
    return nn.Sequential(nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False), nn.BatchNorm2d(outputs),
                         nn.ReLU(inplace=True))


class Residual(nn.Module):
    def __init__(self, channels):
        super().__init__()
        self.first = conv(channels, channels)
        self.second = nn.Sequential(nn.Conv2d(channels, channels, 3, 1, 1, bias=False), nn.BatchNorm2d(channels))

    def forward(self, x):
        return functional.relu(x + self.second(self.first(x)))


class DepthNetwork(nn.Module):
    """`forward`: images of 0 .. 1, N x 1 x H x W with H and W multiples of 32, to the logarithm of inverse depth."""

    def __init__(self, widths=(16, 32, 48, 80, 112)):
        super().__init__()
        w = widths
        self.down = nn.ModuleList([
            nn.Sequential(conv(1, w[0], 2), conv(w[0], w[0])),
            nn.Sequential(conv(w[0], w[1], 2), Residual(w[1])),
            nn.Sequential(conv(w[1], w[2], 2), Residual(w[2]), Residual(w[2])),
            nn.Sequential(conv(w[2], w[3], 2), Residual(w[3]), Residual(w[3])),
            nn.Sequential(conv(w[3], w[4], 2), Residual(w[4])),
        ])
        coarse, self.up = w[4], nn.ModuleList()
        for skip, out in zip((w[3], w[2], w[1], w[0]), (64, 48, 32, 24)):
            self.up.append(conv(coarse + skip, out))
            coarse = out
        # The last step to full size costs nothing but this: each pixel of half the size makes four.
        self.head = nn.Conv2d(coarse, 4, 3, 1, 1)
        nn.init.constant_(self.head.bias, -2.5)  # about 12 m

    def forward(self, x):
        # Exposure says nothing of depth: every image is brought to mean 0 and deviation 1.
        x = x - x.mean((1, 2, 3), keepdim=True)
        x = x * torch.rsqrt((x * x).mean((1, 2, 3), keepdim=True) + 1e-4)
        skips = []
        for down in self.down:
            x = down(x)
            skips.append(x)
        x = skips.pop()
        for up in self.up:
            x = functional.interpolate(x, scale_factor=2.0, mode="nearest")
            x = up(torch.cat([x, skips.pop()], 1))
        return functional.pixel_shuffle(self.head(x), 2)


class InverseDepth(nn.Module):
    """What is exported: inverse depth itself, in about 1/m for a camera like those of the training."""

    def __init__(self, network):
        super().__init__()
        self.network = network

    def forward(self, x):
        return torch.exp(self.network(x))


def without_batch_norm(network):
    """The network with convolutions that have a bias instead of batch normalisation, as ONNX holds it; the same function
    as `network` in evaluation mode. For fine-tuning, whose small batches tell nothing of mean and variance."""
    for module in list(network.modules()):
        if not isinstance(module, nn.Sequential) or len(module) < 2 or not isinstance(module[1], nn.BatchNorm2d):
            continue
        old, norm = module[0], module[1]
        factor = norm.weight.detach() / torch.sqrt(norm.running_var + norm.eps)
        module[0] = nn.Conv2d(old.in_channels, old.out_channels, 3, old.stride, 1)
        module[0].weight.data = old.weight.detach() * factor[:, None, None, None]
        module[0].bias.data = norm.bias.detach() - norm.running_mean * factor
        module[1] = nn.Identity()
    return network


def convolutions(network):
    """In the order in which `forward` runs them, as ONNX lists them."""
    return [module for module in network.modules() if isinstance(module, nn.Conv2d)]
