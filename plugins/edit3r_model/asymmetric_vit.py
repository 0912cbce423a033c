"""Backbone `asymmetric-vit`: one encoder for all views, one decoder for view 0 and one for all
other views.

Ye et al., No Pose, No Problem (ICLR 2025); architecture and default sizes are those of MASt3R.
"""

from dataclasses import dataclass
from functools import lru_cache

import torch
from jaxtyping import Float, Int
from pydantic import Field
from torch import Tensor, nn

import edit3r
from edit3r.contract.errors import InputError, SettingsError
from edit3r.contract.interfaces import Backbone, Geometry
from edit3r.contract.settings import Count
from edit3r.contract.types import Features
from edit3r_model.memory import construct
from edit3r_model.transformer import (
    DecoderBlock,
    EncoderBlock,
    Rotation,
    XavierConv2d,
    XavierLinear,
    layer_norm,
    make_rotation,
    patch_positions,
)

HEAD_WIDTH = 64
"""Channels per attention head of every published model; the number of heads follows unless a
setting says otherwise.
"""
ROLES = 2
"""Number of weight sets: one for the reference view 0, one for all other views."""

Images = Float[Tensor, "batch view 3 height width"]
Intrinsics = Float[Tensor, "batch view 3 3"]
Tokens = Float[Tensor, "batch view token channel"]


class AsymmetricViT(Backbone):
    """ViT encoder (ViT-L by default) and two ViT decoders (ViT-B) that read each other's tokens.

    Any number of views >= 2: view 0 uses the first decoder, all others the second, and each view
    reads the tokens that all other views had one layer before. A field-of-view token, made from the
    normalised intrinsics by one linear layer (the paper's phi), runs along with the patches of each
    view and is dropped at the end. Input sides must be multiples of `patch_size`.
    """

    class Settings(edit3r.Settings):
        width: int = Field(1024, ge=4)
        """encoder channels"""
        depth: Count = 24
        """encoder blocks"""
        heads: int | None = Field(None, ge=1)
        """encoder attention heads; default: width / 64"""
        decoder_width: int = Field(768, ge=4)
        """decoder channels"""
        decoder_depth: int = Field(12, ge=3)
        """blocks of each decoder, which the heads read at four levels"""
        decoder_heads: int | None = Field(None, ge=1)
        """decoder attention heads; default: width / 64"""
        patch_size: Count = 16
        """height and width of a patch [pixels]"""
        seed: int | None = 0
        """of the initial weights; none leaves them empty (no memory), to be filled from a
        checkpoint
        """

    settings: Settings

    def __init__(self, settings: Settings) -> None:
        super().__init__()
        self.settings = settings
        self.patch_size = settings.patch_size
        width, decoder_width = settings.width, settings.decoder_width
        self.heads = _heads("heads", settings.heads, width)
        self.decoder_heads = _heads(
            "decoder_heads", settings.decoder_heads, decoder_width
        )
        self.hooks = hook_levels(settings.decoder_depth)
        self.feature_widths = (width, *(decoder_width for _ in self.hooks[1:]))
        construct(self, self._build, settings.seed)

    def _build(self) -> None:
        s = self.settings
        self.patch_embed = XavierConv2d(3, s.width, s.patch_size, s.patch_size)
        self.intrinsics_embed = nn.Linear(9, s.width)
        self.encoder = nn.ModuleList(
            EncoderBlock(s.width, self.heads, 4 * s.width) for _ in range(s.depth)
        )
        self.encoder_norm = layer_norm(s.width)
        self.decoder_embed = XavierLinear(s.width, s.decoder_width)
        self.decoders = nn.ModuleList(self._decoder() for _ in range(ROLES))
        self.decoder_norm = layer_norm(s.decoder_width)

    def _decoder(self) -> nn.ModuleList:
        width, depth = self.settings.decoder_width, self.settings.decoder_depth
        blocks = (
            DecoderBlock(width, self.decoder_heads, 4 * width) for _ in range(depth)
        )
        return nn.ModuleList(blocks)

    def forward(
        self, images: Images, intrinsics: Intrinsics, geometry: Geometry | None = None
    ) -> Features:
        """Return the four levels that the heads read, see `hook_levels`."""
        return self._features(images, intrinsics, self.hooks)

    def forward_levels(self, images: Images, intrinsics: Intrinsics) -> Features:
        """All levels: 0 the normalised encoder output, then one a block, the last normalised."""
        return self._features(
            images, intrinsics, tuple(range(self.settings.decoder_depth + 1))
        )

    def _features(
        self, images: Images, intrinsics: Intrinsics, wanted: tuple[int, ...]
    ) -> Features:
        """Encode, decode, and keep the `wanted` levels without the intrinsics token."""
        grid, chosen, device = self._grid(images), self.settings, images.device
        tokens = self._embed(images, intrinsics)
        rotation = _cached_rotation(grid, chosen.width // self.heads, device)
        for block in self.encoder:
            tokens = block(tokens, rotation)
        encoded = self.encoder_norm(tokens).unflatten(0, images.shape[:2])
        head_width = chosen.decoder_width // self.decoder_heads
        rotation = _cached_rotation(grid, head_width, device)
        levels = self._decode(encoded, rotation, wanted)
        patches = grid[0] * grid[1]
        return Features(tuple(level[:, :, :patches] for level in levels), grid)

    def _embed(
        self, images: Images, intrinsics: Intrinsics
    ) -> Float[Tensor, "batch_view token width"]:
        """Patches to tokens, and an extra token of the intrinsics behind them."""
        pixels = (images * 2 - 1).flatten(0, 1).to(self.patch_embed.weight.dtype)
        tokens = self.patch_embed(pixels).flatten(2).transpose(1, 2)
        flat = intrinsics.flatten(0, 1).flatten(1)[:, None]
        extra = self.intrinsics_embed(flat.to(tokens.dtype))
        return torch.cat((tokens, extra), 1)

    def _decode(
        self, encoded: Tokens, rotation: Rotation, wanted: tuple[int, ...]
    ) -> list[Tokens]:
        """The `wanted` levels, 0 being `encoded` itself."""
        kept = [encoded] if 0 in wanted else []
        tokens = self.decoder_embed(encoded)  # not a level itself
        roles = assign_roles(tokens.shape[1], tokens.device)
        depth = self.settings.decoder_depth
        for level in range(1, depth + 1):
            # Both sides read the level before: the new tokens replace the old ones only when all
            # are computed.
            sides = []
            for stack, role in zip(self.decoders, roles):
                assert isinstance(stack, nn.ModuleList)  # see _decoder
                own, read = tokens[:, role.own], tokens[:, role.sources]
                sides.append(stack[level - 1](own, read, role.reads, rotation))
            tokens = torch.cat(sides, 1)
            if level in wanted:
                kept.append(self.decoder_norm(tokens) if level == depth else tokens)
        return kept

    def _grid(self, images: Images) -> tuple[int, int]:
        """(rows, columns) of patches. Raises InputError for a single view and unfit sides."""
        (height, width), patch = images.shape[-2:], self.patch_size
        if images.shape[1] < 2:
            raise InputError(
                "asymmetric-vit needs at least 2 views to place them relative to each other, got 1."
            )
        if height % patch or width % patch or min(height, width) < patch:
            raise InputError(
                f"asymmetric-vit takes images whose sides are multiples of {patch} pixels, got "
                f"{height}x{width}; a reconstructor resizes them itself; for the backbone alone, "
                "resize them first."
            )
        return height // patch, width // patch


@dataclass(frozen=True)
class Role:
    """The views that share one set of weights, and what they read of the others."""

    own: slice  # views in this role
    sources: slice  # views that at least one of them reads
    # per own view: positions within `sources`, in view order
    reads: Int[Tensor, "reader read"]


def assign_roles(views: int, device: torch.device | str = "cpu") -> tuple[Role, Role]:
    """Return the roles of `views` >= 2 views; every view reads all views but itself."""
    everyone = torch.arange(views, device=device)
    reference = Role(slice(0, 1), slice(1, views), everyone[None, :-1])
    # Each row all views but its own: with two views nobody reads view 1 from the others' side.
    others = everyone != everyone[1:, None]
    reads = everyone.expand(views - 1, -1)[others].view(views - 1, views - 1)
    last = views if views > 2 else 1
    return reference, Role(slice(1, views), slice(0, last), reads)


def hook_levels(depth: int) -> tuple[int, int, int, int]:
    """Levels that the heads read of a decoder of `depth` blocks: of 12 these are 0, 6, 9, 12."""
    return 0, depth * 2 // 4, depth * 3 // 4, depth


@lru_cache(maxsize=16)
def _cached_rotation(
    grid: tuple[int, int], head_width: int, device: torch.device
) -> Rotation:
    with torch.inference_mode(False):  # a cached table may later be used with gradients
        return make_rotation(patch_positions(grid), head_width, device)


def _heads(name: str, given: int | None, width: int) -> int:
    """Number of attention heads; raises SettingsError where the channels do not divide into that
    many heads.

    The rotation needs the width of a head to be a multiple of 4.
    """
    if given is None and width % HEAD_WIDTH:
        raise SettingsError(
            f"backbone.{name}: {width} channels cannot be split into heads of {HEAD_WIDTH}; set "
            "the number of heads."
        )
    heads = given or width // HEAD_WIDTH
    if width % heads or width // heads % 4:
        raise SettingsError(
            f"backbone.{name}: {width} channels in {heads} heads; expected a head width that is "
            "a multiple of 4."
        )
    return heads
