"""The first layer from bits is the convolution of the unpacked frames."""

import pytest
import torch
from crowdbench_agents.learning.encoder import Encoder
from crowdbench_agents.learning.first_layer import convolve_bits
from crowdbench_agents.learning.inputs import Inputs


def maps_of(count, cells, share=0.1):
    there = torch.rand(count, cells, cells) < share
    return there * torch.randint(0, 256, (count, cells, cells)).to(torch.uint8)


@pytest.mark.parametrize("share", [0.0, 0.1, 1.0])
def test_values_and_gradients_are_the_convolutions(share):
    torch.manual_seed(0)
    layer = torch.nn.Conv3d(1, 16, kernel_size=4, stride=(2, 4, 4), padding=(1, 0, 0))
    maps = maps_of(5, 16, share)
    frames = torch.stack([(maps >> k) & 1 for k in range(8)], dim=1)[:, None].float()
    found, expected = convolve_bits(maps, layer), layer(frames)
    torch.testing.assert_close(found, expected)
    direction = torch.randn_like(expected)
    parameters = list(layer.parameters())
    torch.testing.assert_close(
        torch.autograd.grad(found, parameters, direction),
        torch.autograd.grad(expected, parameters, direction),
        atol=1e-4, rtol=1e-4,
    )  # fmt: skip


@pytest.mark.parametrize("form", ["coarse", "fine"])
def test_an_encoder_returns_the_same_while_it_is_trained(form):
    torch.manual_seed(0)
    encoder = Encoder(16, 32, form)
    inputs = Inputs(maps_of(6, 16), torch.rand(6, 2), torch.randn(6, 2))
    torch.testing.assert_close(encoder.train()(inputs), encoder.eval()(inputs))
