"""Tiny random SAM2, SAM3 and Grounding DINO of the real architectures, saved to disk and loaded as
users do.
"""

import json
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch

import edit3r

if find_spec("transformers") is None:
    pytest.skip("needs transformers", allow_module_level=True)

SIDE = 128  # pixels of the tiny SAM2's square input
WORDS = [
    "[PAD]",
    "[UNK]",
    "[CLS]",
    "[SEP]",
    "[MASK]",
    ".",
    "?",
    "the",
    "a",
    "bike",
    "door",
    "chair",
]


@pytest.fixture(scope="session")
def sam2_folder(tmp_path_factory) -> Path:
    from transformers import Sam2VideoModel

    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("sam2")
    Sam2VideoModel(tiny_sam2_config()).save_pretrained(folder)
    return folder


def tiny_sam2_config():
    """Every width the memory modules tie together is 128; the memory itself is hard-wired to 64."""
    from transformers import Sam2HieraDetConfig, Sam2VideoConfig, Sam2VisionConfig

    hiera = Sam2HieraDetConfig(
        hidden_size=12,
        image_size=[SIDE, SIDE],
        blocks_per_stage=[1, 1, 2, 1],
        embed_dim_per_stage=[12, 24, 48, 96],
        num_attention_heads_per_stage=[1, 2, 4, 8],
        window_size_per_stage=[8, 4, 4, 4],
        global_attention_blocks=[3],
    )
    vision = Sam2VisionConfig(
        backbone_config=hiera.to_dict(),
        backbone_channel_list=[96, 48, 24, 12],
        backbone_feature_sizes=[[32, 32], [16, 16], [8, 8]],
        fpn_hidden_size=128,
    )
    return Sam2VideoConfig(
        vision_config=vision.to_dict(),
        prompt_encoder_config={"hidden_size": 128, "image_size": SIDE},
        mask_decoder_config={
            "hidden_size": 128,
            "mlp_dim": 64,
            "num_attention_heads": 2,
            "iou_head_hidden_dim": 32,
        },
        image_size=SIDE,
        memory_attention_hidden_size=128,
        memory_attention_num_layers=1,
        memory_attention_feed_forward_hidden_size=64,
        memory_attention_rope_feat_sizes=[8, 8],
        memory_encoder_hidden_size=128,
        mask_downsampler_embed_dim=128,
        memory_fuser_num_layers=1,
        memory_fuser_embed_dim=128,
        memory_fuser_intermediate_dim=64,
        # logits of a few units, as a trained network's; the usual 0.02 gives thousandths
        initializer_range=0.15,
    )


@pytest.fixture(scope="session")
def sam3_folder(tmp_path_factory) -> Path:
    """Detector and tracker in one file, under the names that the hub's file has."""
    from safetensors.torch import save_file
    from transformers import Sam3VideoModel

    torch.manual_seed(0)
    folder = tmp_path_factory.mktemp("sam3")
    model = Sam3VideoModel(tiny_sam3_config())
    model.config.save_pretrained(folder)
    state = {name: value.clone() for name, value in model.state_dict().items()}
    save_file(state, folder / "model.safetensors", metadata={"format": "pt"})
    letters = [*"abcdefghijklmnopqrstuvwxyz"]
    tokens = [
        *letters,
        *(f"{letter}</w>" for letter in letters),
        "<|startoftext|>",
        "<|endoftext|>",
    ]
    (folder / "vocab.json").write_text(
        json.dumps({token: number for number, token in enumerate(tokens)})
    )
    (folder / "merges.txt").write_text("#version: 0.2\n")
    return folder


def tiny_sam3_config():
    from transformers import Sam3VideoConfig

    side, width = 112, 128
    vision = {
        "backbone_config": {
            "model_type": "sam3_vit_model",
            "hidden_size": 32,
            "intermediate_size": 64,
            "num_hidden_layers": 2,
            "num_attention_heads": 2,
            "image_size": side,
            "patch_size": 14,
            "window_size": 4,
            "global_attn_indexes": [1],
            "pretrain_image_size": 56,
        },
        "fpn_hidden_size": width,
        "backbone_feature_sizes": [[32, 32], [16, 16], [8, 8]],
    }
    part = {
        "hidden_size": width,
        "intermediate_size": 64,
        "num_attention_heads": 2,
        "num_layers": 1,
    }
    detector = {
        "vision_config": vision,
        "text_config": {
            "vocab_size": 54,
            "hidden_size": 32,
            "intermediate_size": 64,
            "num_hidden_layers": 1,
            "num_attention_heads": 2,
            "max_position_embeddings": 32,
            "projection_dim": 32,
        },
        "geometry_encoder_config": part,
        "detr_encoder_config": part,
        "detr_decoder_config": {**part, "num_layers": 2, "num_queries": 8},
        "mask_decoder_config": {"hidden_size": width, "num_attention_heads": 2},
        "initializer_range": 0.15,
    }
    tracker = {
        "vision_config": {**vision, "model_type": "sam3_vision_model"},
        "prompt_encoder_config": {"hidden_size": width, "image_size": side},
        "mask_decoder_config": {
            "hidden_size": width,
            "mlp_dim": 64,
            "num_attention_heads": 2,
            "iou_head_hidden_dim": 32,
        },
        "image_size": side,
        "memory_attention_hidden_size": width,
        "memory_attention_num_layers": 1,
        "memory_attention_feed_forward_hidden_size": 64,
        "memory_attention_rope_feat_sizes": [8, 8],
        "memory_encoder_hidden_size": width,
        "mask_downsampler_embed_dim": width,
        "memory_fuser_num_layers": 1,
        "memory_fuser_embed_dim": width,
        "memory_fuser_intermediate_dim": 64,
        "initializer_range": 0.15,
    }
    return Sam3VideoConfig(detector_config=detector, tracker_config=tracker)


SAM_ENCODER = """<ir_version: 8, opset_import: ["" : 17]>
encoder (float[1, 3, 64, 64] image) => (float[1, 3, 16, 16] high_res_feats_0,
         float[1, 3, 8, 8] high_res_feats_1, float[1, 3, 4, 4] image_embed) {
    high_res_feats_0 = AveragePool <kernel_shape = [4, 4], strides = [4, 4]> (image)
    high_res_feats_1 = AveragePool <kernel_shape = [8, 8], strides = [8, 8]> (image)
    image_embed = AveragePool <kernel_shape = [16, 16], strides = [16, 16]> (image)
}"""
# Discs of three sizes around the first point; masks and how good they are are inner values.
SAM_DECODER = """<ir_version: 8, opset_import: ["" : 17]>
decoder (float[1, 3, 16, 16] high_res_feats_0, float[1, 3, 8, 8] high_res_feats_1,
         float[1, 3, 4, 4] image_embed, float[1, n, 2] point_coords, float[1, n] point_labels,
         float[1, 1, 256, 256] mask_input, float[1] has_mask_input) => (float[a, b, c, d] masks) {
    zero = Constant <value = int64[1] {0}> ()
    one = Constant <value = int64[1] {1}> ()
    side = Constant <value = float {4.0}> ()
    scaled = Div (point_coords, side)
    first = Slice (scaled, zero, one, one)
    two = Constant <value = int64[1] {2}> ()
    x = Slice (first, zero, one, two)
    y = Slice (first, one, two, two)
    from = Constant <value = float {0.5}> ()
    to = Constant <value = float {16.0}> ()
    step = Constant <value = float {1.0}> ()
    line = Range (from, to, step)
    across = Constant <value = int64[4] {1, 1, 1, 16}> ()
    down = Constant <value = int64[4] {1, 1, 16, 1}> ()
    columns = Reshape (line, across)
    rows = Reshape (line, down)
    off_x = Sub (columns, x)
    off_y = Sub (rows, y)
    square_x = Mul (off_x, off_x)
    square_y = Mul (off_y, off_y)
    square = Add (square_x, square_y)
    distance = Sqrt (square)
    listed = Constant <value = float[3] {1.5, 3.0, 6.0}> ()
    apart = Constant <value = int64[4] {1, 3, 1, 1}> ()
    radii = Reshape (listed, apart)
    logits = Sub (radii, distance)
    believed = Constant <value = float[3] {0.5, 0.9, 0.7}> ()
    flat = Constant <value = int64[2] {1, 3}> ()
    quality = Reshape (believed, flat)
    masks = Identity (logits)
}"""


@pytest.fixture(scope="session")
def sam_onnx_folder(tmp_path_factory) -> Path:
    """A SAM 2 that answers with discs around the first click, of a smaller form."""
    folder = tmp_path_factory.mktemp("sam2-onnx")
    parser = pytest.importorskip("onnx").parser
    for name, text in (("encoder", SAM_ENCODER), ("sam", SAM_DECODER)):
        model = parser.parse_model(text)
        (folder / f"{name}.onnx").write_bytes(model.SerializeToString())
    return folder


@pytest.fixture
def sam_onnx_files(sam_onnx_folder, monkeypatch) -> dict[str, str]:
    """Its settings, where the segmenter expects that form."""
    monkeypatch.setattr("edit3r_segmenters.sam_onnx.SIDE", 64)
    monkeypatch.setattr("edit3r_segmenters.sam_onnx.OUTPUTS", ("logits", "quality"))
    names = {"encoder": "encoder.onnx", "decoder": "sam.onnx"}
    return {which: str(sam_onnx_folder / name) for which, name in names.items()}


@pytest.fixture
def build_sam_onnx(sam_onnx_files):
    def build(**settings):
        return edit3r.build("segmenter", "sam-onnx", **(sam_onnx_files | settings))

    return build


@pytest.fixture(scope="session")
def dino_folder(tmp_path_factory) -> Path:
    from transformers import (
        BertTokenizer,
        GroundingDinoConfig,
        GroundingDinoForObjectDetection,
        GroundingDinoImageProcessorPil,
        GroundingDinoProcessor,
    )

    folder = tmp_path_factory.mktemp("dino")
    (folder / "vocab.txt").write_text("\n".join(WORDS) + "\n")
    config = GroundingDinoConfig(
        backbone_config={
            "model_type": "swin",
            "image_size": 64,
            "embed_dim": 16,
            "depths": [1, 1, 1, 1],
            "num_heads": [1, 1, 2, 2],
            "window_size": 4,
            "out_indices": [2, 3, 4],
        },
        text_config={
            "model_type": "bert",
            "vocab_size": len(WORDS),
            "hidden_size": 32,
            "num_hidden_layers": 1,
            "num_attention_heads": 2,
            "intermediate_size": 32,
        },
        d_model=32,
        encoder_layers=1,
        decoder_layers=2,  # one breaks the weight tying
        encoder_attention_heads=2,
        decoder_attention_heads=2,
        encoder_ffn_dim=32,
        decoder_ffn_dim=32,
        num_queries=8,
        max_text_len=16,
    )
    torch.manual_seed(0)
    GroundingDinoForObjectDetection(config).save_pretrained(folder)
    images = GroundingDinoImageProcessorPil(
        size={"shortest_edge": 64, "longest_edge": 96}
    )
    GroundingDinoProcessor(
        images, BertTokenizer(str(folder / "vocab.txt"))
    ).save_pretrained(folder)
    return folder


@pytest.fixture(scope="session")
def build_sam2(sam2_folder, dino_folder):
    """The segmenter with its real detector, both tiny; quality bounds off, since random masks are
    poor.
    """

    def build(parts=None, **settings):
        settings = {
            "model": str(sam2_folder),
            "local_files_only": True,
            **settings,
        }
        if parts is None:
            settings.setdefault(
                "detector", {"model": str(dino_folder), "box_threshold": 0.0}
            )
        return edit3r.build("segmenter", "sam2", parts, **settings)

    return build


@pytest.fixture(scope="session")
def build_sam3(sam3_folder):
    """SAM3 with quality bounds off."""

    def build(**settings):
        chosen = {
            "model": str(sam3_folder),
            "local_files_only": True,
            "min_score": 0.0,
            **settings,
        }
        return edit3r.build("segmenter", "sam3", **chosen)

    return build


@pytest.fixture
def at_hand(monkeypatch, tmp_path, sam2_folder, dino_folder):
    """Put the tiny networks where `edit3r weights get` puts the real ones."""
    monkeypatch.setenv("EDIT3R_WEIGHTS", str(tmp_path / "weights"))
    monkeypatch.setenv("HF_HOME", str(tmp_path / "hub"))
    (tmp_path / "weights").mkdir()

    def put(*names: str) -> None:
        for name in names:
            (tmp_path / "weights" / name).symlink_to(
                dino_folder if "dino" in name else sam2_folder
            )

    return put


@pytest.fixture(scope="session")
def photo() -> torch.Tensor:
    """60 x 80: a bright disc on a dark slope."""
    y, x = torch.meshgrid(
        torch.linspace(0, 1, 60), torch.linspace(0, 1, 80), indexing="ij"
    )
    disc = ((x - 0.3) ** 2 + (y - 0.5) ** 2 < 0.04).float()
    return torch.stack((0.2 * x + 0.7 * disc, 0.2 * y, 0.1 + 0.5 * disc)).clamp(0, 1)
