"""Tiny random models with the real architectures, saved to disk and loaded the way users load
theirs.
"""

import json
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch

import edit3r

# Not imported here: that takes seconds in every process, whatever tests it gets.
if not (find_spec("diffusers") and find_spec("transformers")):
    pytest.skip("needs diffusers and transformers", allow_module_level=True)

SIZE = 32  # pixels; a tiny VAE halves it once
# Of every transformer, of every encoder of texts, and of a VAE that brings its own convolutions.
BLOCKS = {"num_layers": 1, "attention_head_dim": 16, "num_attention_heads": 2}
TEXTS = {"hidden_size": 16, "intermediate_size": 16}
BARE = {"use_quant_conv": False, "use_post_quant_conv": False}


@pytest.fixture(scope="session", autouse=True)
def small_pictures():
    """Keep the classes that enlarge every picture to a megapixel at the size of the tests."""
    from diffusers.pipelines.longcat_image import pipeline_longcat_image_edit as longcat
    from diffusers.pipelines.qwenimage import pipeline_qwenimage_edit_plus as qwen

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(longcat, "calculate_dimensions", lambda area, ratio: (64, 64))
        patch.setattr(qwen, "VAE_IMAGE_SIZE", 32 * 32)
        patch.setattr(qwen, "CONDITION_IMAGE_SIZE", 56 * 56)
        yield


@pytest.fixture(scope="session")
def tiny(tmp_path_factory) -> "TinyModels":
    return TinyModels(tmp_path_factory.mktemp("models"))


class TinyModels:
    """Folders of models by name, each made on first use."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def instruct_pix2pix(self) -> Path:
        from diffusers import StableDiffusionInstructPix2PixPipeline

        return self._saved(
            "instruct-pix2pix",
            lambda: StableDiffusionInstructPix2PixPipeline(**self.sd_parts(8)),
        )

    def stable_diffusion(self) -> Path:
        from diffusers import StableDiffusionPipeline

        return self._saved(
            "stable-diffusion", lambda: StableDiffusionPipeline(**self.sd_parts(4))
        )

    def controlnet(self) -> Path:
        """With random instead of zero convolutions: as initialised, a ControlNet changes
        nothing.
        """
        from diffusers import ControlNetModel, UNet2DConditionModel

        def make():
            model, out = self.stable_diffusion(), (16, 32)
            unet = UNet2DConditionModel.from_pretrained(model, subfolder="unet")
            net = ControlNetModel.from_unet(
                unet, conditioning_channels=3, conditioning_embedding_out_channels=out
            )
            zero = [p for p in net.parameters() if not p.any() and p.ndim == 4]
            assert zero
            with torch.no_grad():
                for parameter in zero:
                    parameter.normal_(0, 0.3)
            return net

        return self._saved("controlnet", make)

    def flux_kontext(self) -> Path:
        from diffusers import FluxKontextPipeline

        return self._saved(
            "flux-kontext", lambda: FluxKontextPipeline(**self.flux_parts())
        )

    def qwen_image_edit(self) -> Path:
        from diffusers import (
            AutoencoderKLQwenImage,
            FlowMatchEulerDiscreteScheduler,
            QwenImageTransformer2DModel,
        )

        parts = {
            "transformer": lambda: QwenImageTransformer2DModel(
                **{"patch_size": 2, "in_channels": 16, "out_channels": 4} | BLOCKS,
                joint_attention_dim=16,
                guidance_embeds=False,
                axes_dims_rope=(8, 4, 4),
            ),
            "vae": lambda: AutoencoderKLQwenImage(
                **{"base_dim": 8, "z_dim": 4, "num_res_blocks": 1},
                dim_mult=[1, 2, 4],
                temperal_downsample=[False, True],
                latents_mean=[0.0] * 4,
                latents_std=[1.0] * 4,
            ),
            "scheduler": FlowMatchEulerDiscreteScheduler,
            "text_encoder": self.qwen_vl,
            "tokenizer": self.qwen_tokenizer,
            "processor": self.qwen_pictures,
        }
        return self._saved_by_parts(
            "qwen-image-edit", "QwenImageEditPlusPipeline", parts
        )

    def longcat_image_edit(self) -> Path:
        """With a VAE that halves three times, as theirs: the class enlarges every picture to a
        megapixel.
        """
        from diffusers import (
            AutoencoderKL,
            FlowMatchEulerDiscreteScheduler,
            LongCatImageTransformer2DModel,
        )

        parts = {
            "transformer": lambda: LongCatImageTransformer2DModel(
                **{"in_channels": 64, "num_single_layers": 1} | BLOCKS,
                joint_attention_dim=16,
                pooled_projection_dim=16,
                axes_dims_rope=[4, 4, 8],
            ),
            "vae": lambda: self.vae(
                AutoencoderKL,
                channels=(8,) * 4,
                latent_channels=16,
                shift_factor=0.1,
                mid_block_add_attention=False,
                **BARE,
            ),
            "scheduler": FlowMatchEulerDiscreteScheduler,
            "text_encoder": self.qwen_vl,
            "tokenizer": self.qwen_tokenizer,
            "text_processor": self.qwen_pictures,
        }
        return self._saved_by_parts(
            "longcat-image-edit", "LongCatImageEditPipeline", parts
        )

    def flux2_klein(self) -> Path:
        from diffusers import (
            AutoencoderKLFlux2,
            FlowMatchEulerDiscreteScheduler,
            Flux2Transformer2DModel,
        )
        from transformers import Qwen3Config, Qwen3ForCausalLM

        text = Qwen3Config(
            **{"num_attention_heads": 2, "num_key_value_heads": 2, "head_dim": 8},
            num_hidden_layers=28,  # three of which, up to number 27, are read
            **{"vocab_size": 300, "max_position_embeddings": 512} | TEXTS,
        )
        parts = {
            "transformer": lambda: Flux2Transformer2DModel(
                **{"patch_size": 1, "in_channels": 16, "num_single_layers": 1},
                **BLOCKS,
                joint_attention_dim=48,
                timestep_guidance_channels=32,
                axes_dims_rope=[4, 4, 4, 4],
                guidance_embeds=False,
            ),
            "vae": lambda: self.vae(AutoencoderKLFlux2, **BARE),
            "scheduler": FlowMatchEulerDiscreteScheduler,
            "text_encoder": lambda: Qwen3ForCausalLM(text).eval(),
            "tokenizer": self.qwen_tokenizer,
        }
        return self._saved_by_parts(
            "flux2-klein", "Flux2KleinPipeline", parts, is_distilled=True
        )

    def qwen_vl(self):
        from transformers import Qwen2_5_VLConfig, Qwen2_5_VLForConditionalGeneration

        rope = {"mrope_section": [1, 1, 2], "rope_type": "default", "rope_theta": 1e4}
        heads = {"num_attention_heads": 2, "num_key_value_heads": 2}
        text = {"num_hidden_layers": 1, "vocab_size": 300, "rope_parameters": rope}
        tokens = ("vision_start", "vision_end", "image", "video")
        config = Qwen2_5_VLConfig(
            text_config=TEXTS | heads | text,
            vision_config=TEXTS | {"depth": 1, "num_heads": 2, "out_hidden_size": 16},
            **{f"{name}_token_id": 259 + index for index, name in enumerate(tokens)},
        )
        return Qwen2_5_VLForConditionalGeneration(config).eval()

    def qwen_tokenizer(self):
        """A byte-level tokenizer with the special tokens that the Qwen family reads."""
        from transformers import Qwen2Tokenizer
        from transformers.convert_slow_tokenizer import bytes_to_unicode

        folder = self._vocabulary("qwen", bytes_to_unicode().values())
        special = [f"<|im_{name}|>" for name in ("start", "end")]
        special += [f"<|vision_{name}|>" for name in ("start", "end")]
        special += [f"<|{name}_pad|>" for name in ("image", "video")]
        tokenizer = Qwen2Tokenizer.from_pretrained(
            folder, additional_special_tokens=special
        )
        tokenizer.chat_template = (
            "{% for m in messages %}<|im_start|>{{ m.role }}\n{{ m.content }}<|im_end|>\n{% "
            "endfor %}"
            "<|im_start|>assistant\n"
        )
        return tokenizer

    def _vocabulary(self, name: str, words) -> Path:
        """A folder with these words and no pairs of them."""
        folder = self.root / f"{name}-vocabulary"
        folder.mkdir(exist_ok=True)
        numbered = {word: index for index, word in enumerate(words)}
        (folder / "vocab.json").write_text(json.dumps(numbered))
        (folder / "merges.txt").write_text("#version: 0.2\n")
        return folder

    def qwen_pictures(self):
        from transformers import Qwen2VLImageProcessor

        return Qwen2VLImageProcessor(min_pixels=56 * 56, max_pixels=56 * 56)

    def _saved_by_parts(self, name: str, pipeline: str, parts: dict, **flags) -> Path:
        """A pipeline's folder written part by part; its processor of class Qwen2VLProcessor cannot
        be made here.
        """
        folder = self.root / name
        if not folder.is_dir():
            torch.manual_seed(0)
            index = {"_class_name": pipeline, "_diffusers_version": "0.42.0", **flags}
            for part, make in parts.items():
                made = make()
                made.save_pretrained(folder / part)
                library, kind = type(made).__module__.partition(".")[0], type(made)
                reads = "Qwen2VLProcessor" if "processor" in part else kind.__name__
                index[part] = [library, reads]
            (folder / "model_index.json").write_text(json.dumps(index))
        return folder

    def _saved(self, name: str, make) -> Path:
        folder = self.root / name
        if not folder.is_dir():
            torch.manual_seed(0)
            make().save_pretrained(folder)
        return folder

    def sd_parts(self, latent_channels: int) -> dict:
        """Parts of a Stable Diffusion 1.x pipeline; InstructPix2Pix's UNet takes 8 channels:
        latents and photo.
        """
        from diffusers import AutoencoderKL, DDIMScheduler, UNet2DConditionModel

        unet = UNet2DConditionModel(
            in_channels=latent_channels,
            out_channels=4,
            sample_size=16,
            block_out_channels=(32, 64),
            layers_per_block=1,
            down_block_types=("DownBlock2D", "CrossAttnDownBlock2D"),
            up_block_types=("CrossAttnUpBlock2D", "UpBlock2D"),
            cross_attention_dim=32,
            attention_head_dim=4,
            norm_num_groups=8,
        )
        scheduler = DDIMScheduler(
            **{"beta_start": 0.00085, "beta_end": 0.012},
            beta_schedule="scaled_linear",
            **{"clip_sample": False, "set_alpha_to_one": False, "steps_offset": 1},
        )
        return {
            "unet": unet,
            "scheduler": scheduler,
            "vae": self.vae(AutoencoderKL),
            "text_encoder": self.clip_text(),
            "tokenizer": self.clip_tokenizer(),
            "safety_checker": None,
            "feature_extractor": None,
            "requires_safety_checker": False,
        }

    def flux_parts(self) -> dict:
        from diffusers import (
            AutoencoderKL,
            FlowMatchEulerDiscreteScheduler,
            FluxTransformer2DModel,
        )
        from transformers import T5Config, T5EncoderModel

        transformer = FluxTransformer2DModel(
            **{"in_channels": 16, "num_single_layers": 1} | BLOCKS,
            joint_attention_dim=32,
            pooled_projection_dim=32,
            axes_dims_rope=(4, 4, 8),
            guidance_embeds=True,
        )
        t5 = T5Config(
            vocab_size=300, d_model=32, d_kv=8, d_ff=37, num_layers=1, num_heads=4
        )
        return {
            "transformer": transformer,
            "scheduler": FlowMatchEulerDiscreteScheduler(),
            "vae": self.vae(AutoencoderKL, shift_factor=0.1, **BARE),
            "text_encoder": self.clip_text(),
            "tokenizer": self.clip_tokenizer(),
            "text_encoder_2": T5EncoderModel(t5).eval(),
            "tokenizer_2": self.t5_tokenizer(),
        }

    def vae(self, cls, channels=(32, 64), latent_channels=4, **given):
        return cls(
            block_out_channels=channels,
            down_block_types=("DownEncoderBlock2D",) * len(channels),
            up_block_types=("UpDecoderBlock2D",) * len(channels),
            latent_channels=latent_channels,
            norm_num_groups=8,
            sample_size=SIZE,
            **given,
        )

    def clip_text(self):
        from transformers import CLIPTextConfig, CLIPTextModel

        config = CLIPTextConfig(
            **{"vocab_size": 514, "hidden_size": 32, "intermediate_size": 37},
            **{"num_hidden_layers": 2, "num_attention_heads": 4},
            **{"bos_token_id": 512, "eos_token_id": 513, "pad_token_id": 513},
        )
        return CLIPTextModel(config).eval()

    def clip_tokenizer(self):
        """A byte-level CLIP tokenizer whose vocabulary is the 256 bytes, alone and at word end."""
        from transformers import CLIPTokenizer
        from transformers.convert_slow_tokenizer import bytes_to_unicode

        letters = list(bytes_to_unicode().values())
        words = [*letters, *(letter + "</w>" for letter in letters)]
        folder = self._vocabulary("clip", [*words, "<|startoftext|>", "<|endoftext|>"])
        return CLIPTokenizer.from_pretrained(folder, model_max_length=77)

    def t5_tokenizer(self):
        from tokenizers import Tokenizer, decoders, models, pre_tokenizers, processors
        from transformers import T5TokenizerFast

        pieces = ["<pad>", "</s>", "<unk>", "▁", *map(chr, range(33, 127))]
        scores = [(piece, -float(i)) for i, piece in enumerate(pieces)]
        core = Tokenizer(models.Unigram(scores, unk_id=2))
        core.pre_tokenizer = pre_tokenizers.Metaspace()
        core.decoder = decoders.Metaspace()
        core.post_processor = processors.TemplateProcessing(
            single="$A </s>", special_tokens=[("</s>", 1)]
        )
        special = {"eos_token": "</s>", "unk_token": "<unk>", "pad_token": "<pad>"}
        return T5TokenizerFast(tokenizer_object=core, extra_ids=0, **special)


@pytest.fixture(scope="session")
def two_views() -> edit3r.Views:
    """Two smooth pictures that differ."""
    y, x = torch.meshgrid(2 * [torch.linspace(0, 1, SIZE)], indexing="ij")
    first = torch.stack((x, y, 0.5 * (x + y)))
    second = torch.stack((y, 1 - x, x * y))
    lens = torch.tensor([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]]).expand(1, 2, 3, 3)
    both = torch.stack((first, second))[None]
    return edit3r.Views(both, lens, ("left.png", "right.png"))


@pytest.fixture(scope="session")
def left_half() -> torch.Tensor:
    """A mask that lets the left half change, for both views."""
    mask = torch.zeros(1, 2, SIZE, SIZE)
    mask[..., : SIZE // 2] = 1
    return mask
