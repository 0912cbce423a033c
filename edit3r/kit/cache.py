"""What slow stages answered, kept by the hash of all that the answer depends on.

A method marked `@remembered` asks the cache of the current run before it works. A command keeps its
cache in the folder `cache/` of the results, so that `--from` finds the answers again; a program
that stays open keeps one `Cache` and passes it to every run. Without a cache, `@remembered` does
nothing.

Entries are safetensors files, so opening a stranger's folder runs no code. Each holds its own
checksum. An entry that cannot be read or was changed is an error that names the file: deleting
`cache/` is always safe.
"""

import dataclasses
import functools
import hashlib
import inspect
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Tensor

from edit3r.contract.errors import one_line
from edit3r.contract.reporting import note, warn
from edit3r.kit.weights.find import at_hand
from edit3r.version import __version__

Method = TypeVar("Method", bound=Callable)
Entry = tuple[Any, dict[str, Tensor]]
"""An answer as JSON data, and the tensors that stand in it as numbers; see `_pack`."""


class Cache:
    """Answers by key, in memory and, where a folder is given, in the files of an earlier run."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._entries: dict[str, Entry] = {}
        self.reused: list[str] = []
        self.computed: list[str] = []

    def recall(
        self,
        name: str,
        key: str,
        compute: Callable[[], Any],
        device: torch.device | str = "cpu",
    ) -> Any:
        """The answer `name` that is kept under `key`, on `device`; else compute and keep it."""
        file_name = f"{name}-{key}.safetensors"
        entry = self._entries.get(file_name) or self._read(file_name)
        if entry is None:
            answer = compute()
            tensors: dict[str, Tensor] = {}
            entry = _pack(answer, tensors), tensors
            self.computed.append(name)
        else:
            tree, stored = entry
            answer = _unpack(tree, {n: value.to(device) for n, value in stored.items()})
            self.reused.append(name)
        self._entries[file_name] = entry
        note("cache.reused", list(self.reused))
        note("cache.computed", list(self.computed))
        return answer

    def save(self, folder: Path) -> None:
        """Write every answer that this run asked for into `folder`."""
        from safetensors.torch import save

        folder.mkdir(parents=True, exist_ok=True)
        for file_name, (tree, tensors) in self._entries.items():
            content = {name: value.contiguous() for name, value in tensors.items()}
            # The answer's structure travels as text in a tensor of bytes.
            text = json.dumps({"tree": tree, "checksum": fingerprint(tree, content)})
            content["tree"] = torch.frombuffer(
                bytearray(text.encode()), dtype=torch.uint8
            )
            (folder / file_name).write_bytes(save(content))

    def _read(self, file_name: str) -> Entry | None:
        from safetensors.torch import load

        file = None if self._folder is None else self._folder / file_name
        if file is None or not file.is_file():
            return None
        try:
            tensors = load(file.read_bytes())
            content = json.loads(bytes(tensors.pop("tree").tolist()))
            tree = content["tree"]
            if fingerprint(tree, tensors) != content["checksum"]:
                raise ValueError("its checksum does not match")
            _unpack(tree, tensors)
        except Exception as error:  # safetensors has no error class of its own
            warn(
                f"{file}: cannot be read ({one_line(error)}); its content is computed again."
            )
            return None
        return tree, tensors


_current: ContextVar[Cache | None] = ContextVar("edit3r_cache", default=None)


@contextmanager
def using(cache: Cache | None) -> Iterator[None]:
    """Let `@remembered` methods inside the block use `cache`; None switches remembering off."""
    token = _current.set(cache)
    try:
        yield
    finally:
        _current.reset(token)


def remembered(method: Method) -> Method:
    """Mark a method of a component as one whose answer the run's cache keeps.

    The answer must depend on nothing but the component (its settings, parts and weights) and the
    arguments, and consist of tensors, numbers, texts, tuples and the data classes of
    `edit3r.contract.types` and `edit3r.contract.interfaces`. Remembered, its tensors are on the
    device of the first tensor among the arguments.
    """

    @functools.wraps(method)
    def wrapper(component: Any, *args: Any, **kwargs: Any) -> Any:
        arguments = (method.__qualname__, args, kwargs)
        compute = functools.partial(method, component, *args, **kwargs)
        return recall(method.__name__, component, arguments, compute)

    return wrapper  # type: ignore[return-value]


def recall(
    name: str, component: Any, arguments: Any, compute: Callable[[], Any]
) -> Any:
    """Return what `compute` gives for a component and its arguments, by the run's cache if any."""
    cache = _current.get()
    if cache is None:
        return compute()
    key = fingerprint(identity(component), name, arguments)
    device = next((tensor.device for tensor in _tensors(arguments)), "cpu")
    return cache.recall(name, key, compute, device)


def _tensors(thing: Any) -> Iterator[Tensor]:
    """The tensors in data classes, sequences and mappings."""
    if isinstance(thing, Tensor):
        yield thing
    elif dataclasses.is_dataclass(thing):
        yield from _tensors(vars(thing))
    elif isinstance(thing, Mapping):
        yield from _tensors(list(thing.values()))
    elif isinstance(thing, list | tuple):
        for item in thing:
            yield from _tensors(item)


def fingerprint(*things: Any) -> str:
    """Return the hex digest of tensors, data classes and JSON data, in sequences and mappings."""
    digest = hashlib.blake2b(digest_size=16)
    for thing in things:
        _add(digest, thing)
    return digest.hexdigest()


def identity(component: Any) -> str:
    """Return a digest of all that a component's answers depend on besides its arguments.

    These are its name, plugin and version, its source file, settings, parts, the weights of its
    network, and which of the weights that it declares are on this machine. A change in another file
    of the plugin, without a new version, goes unnoticed.
    """
    cls: Any = type(component)
    known: list[Any] = [__version__, cls.__qualname__, _source_digest(cls)]
    offer = getattr(component, "offer", None)
    if offer is not None:
        weights = [one.name for one in offer.component.weights if at_hand(one)]
        known += [offer.qualified_name, offer.version, weights]
    settings = getattr(component, "settings", None)
    if settings is not None:
        known.append(settings.model_dump_json())
    parts = getattr(component, "parts", None) or {}
    inner = {kind: identity(part) for kind, part in parts.items()}
    return fingerprint(known, inner, _weight_sums(component))


def _add(digest: hashlib.blake2b, thing: Any) -> None:
    if isinstance(thing, Tensor):
        values = thing.detach().cpu().contiguous()
        digest.update(f"{values.dtype}{list(values.shape)}".encode())
        if values.numel():
            digest.update(values.flatten().view(torch.uint8).numpy().data)
    elif dataclasses.is_dataclass(thing):
        fields = {
            field.name: getattr(thing, field.name)
            for field in dataclasses.fields(thing)
        }
        fields.pop("names", None)  # names change no answer
        _add(digest, fields)
    elif isinstance(thing, Mapping):
        _add(digest, sorted(thing.items()))
    elif isinstance(thing, list | tuple):
        digest.update(f"({len(thing)}".encode())
        for item in thing:
            _add(digest, item)
    else:
        digest.update(json.dumps(thing).encode() + b"\n")


@functools.cache
def _source_digest(cls: type) -> str:
    try:
        return fingerprint(Path(inspect.getfile(cls)).read_text(encoding="utf-8"))
    except (OSError, TypeError):  # a class made in a console has no file
        return ""


def _weight_sums(component: Any) -> list[tuple[str, float, float]]:
    """Two sums per tensor of the network: training changes them, and they take a second at most."""
    network = getattr(component, "network", None)
    sums = []
    for name, value in network.state_dict().items() if network is not None else ():
        if value.is_floating_point():
            value = value.detach().double()
            sums.append((name, float(value.sum()), float(value.square().sum())))
    return sums


def _pack(value: Any, tensors: dict[str, Tensor]) -> Any:
    """Turn an answer into JSON data; copies of its tensors go into `tensors`, by a number each."""
    if isinstance(value, Tensor):
        number = str(len(tensors))
        tensors[number] = value.detach().to("cpu", copy=True)
        return {"tensor": number}
    if dataclasses.is_dataclass(value):
        fields = {
            field.name: _pack(getattr(value, field.name), tensors)
            for field in dataclasses.fields(value)
        }
        return {"class": type(value).__name__, "fields": fields}
    if isinstance(value, tuple):
        return {"tuple": [_pack(item, tensors) for item in value]}
    return value


def _unpack(tree: Any, tensors: dict[str, Tensor]) -> Any:
    """Return the answer that `_pack` turned into `tree` and `tensors`."""
    if not isinstance(tree, dict):
        return tree
    if "tensor" in tree:
        return tensors[tree["tensor"]].clone()
    if "tuple" in tree:
        return tuple(_unpack(item, tensors) for item in tree["tuple"])
    fields = {name: _unpack(item, tensors) for name, item in tree["fields"].items()}
    return _storable()[tree["class"]](**fields)


@functools.cache
def _storable() -> dict[str, type]:
    """The data classes that an answer may hold, by name: those of the contract."""
    from edit3r.contract import interfaces, types

    known = {**vars(types), **vars(interfaces)}
    return {
        name: cls
        for name, cls in known.items()
        if isinstance(cls, type) and dataclasses.is_dataclass(cls)
    }
