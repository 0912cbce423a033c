"""`load_weights`: any supported weight file, by path or hub id."""

import hashlib
from collections.abc import Mapping
from pathlib import Path

from torch import Tensor

from edit3r.errors import InputError
from edit3r_model.checkpoints import native, official
from edit3r_model.checkpoints.hub import download, is_hub_id
from edit3r_model.checkpoints.loaded import LoadedWeights
from edit3r_model.checkpoints.parameters import parameter_names
from edit3r_model.checkpoints.sizes import infer_config

LICENCES = {
    "noposplat": "not stated in the file; the published NoPoSplat weights start from MASt3R's, which are CC BY-NC-SA "
    "4.0 (non-commercial)",
    "mast3r": "CC BY-NC-SA 4.0 (non-commercial), as MASt3R's publishers state",
}


def load_weights(source: str | Path) -> LoadedWeights:
    """Open a Lightning `.ckpt`, a MASt3R `.pth`, a `.safetensors` file, our folder, or a hub id `owner/name@revision`.

    Tensors stay on disk until used. Raises InputError when the file is none of these or is damaged.
    """
    path = download(str(source)) if is_hub_id(str(source)) else Path(source)
    if path.is_dir():
        path = path / native.WEIGHTS
    if not path.is_file():
        raise InputError(
            f"{source}: no such weights; expected a .ckpt, .pth or .safetensors file, a folder with {native.WEIGHTS} "
            f"and {native.CONFIG}, or a hub id owner/name@revision."
        )
    if path.suffix == ".safetensors":
        tensors = native.read_safetensors(path)
        if (path.parent / native.CONFIG).is_file():
            return _native(tensors, path, str(source))
        return _official(tensors, path, str(source))
    return _official(official.read_torch_file(path), path, str(source))


def _native(tensors: Mapping[str, Tensor], path: Path, source: str) -> LoadedWeights:
    config, about = native.read_config(path.parent / native.CONFIG)
    return LoadedWeights(config, tensors, source, "edit3r", _sha256(path), about.get("licence", "not stated"))


def _official(content: Mapping[str, object], path: Path, source: str) -> LoadedWeights:
    kind, tensors = official.normalise(content, path)
    config = infer_config(tensors, source)
    state = official.OfficialState(tensors, parameter_names(config))
    return LoadedWeights(
        config,
        state,
        source,
        kind,
        _sha256(path),
        LICENCES[kind],
        drawn=official.DRAWN_FROM_MAST3R if kind == "mast3r" else (),
        unexpected=state.unexpected(),
    )


def _sha256(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 22):
            digest.update(block)
    return digest.hexdigest()
