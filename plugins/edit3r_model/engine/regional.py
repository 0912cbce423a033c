"""`torch.compile` of the repeated blocks, one by one.

Blocks of one kind share their compiled code, so a deep network compiles as fast as a shallow one, and the control flow
around them (roles, strips, sizes) stays ordinary Python.
"""

from torch import nn

from edit3r_model.blocks import DecoderBlock, EncoderBlock
from edit3r_model.dpt import ResidualUnit

REGIONS = (EncoderBlock, DecoderBlock, ResidualUnit)


def compile_regions(network: nn.Module) -> None:
    """Compile every block in place, at its first use; a network without such blocks is compiled as a whole."""
    regions = [module for module in network.modules() if isinstance(module, REGIONS)]
    for module in regions or [network]:
        module.compile()
