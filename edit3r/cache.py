"""What slow stages answered, kept by the hash of all that the answer depends on.

A method marked `@remembered` asks the cache of the current run before it works. A command keeps its
cache in the folder `cache/` of the results, so that `--from` finds the answers again; a program
that stays open keeps one `Cache` and passes it to every run. Without a cache, `@remembered` does
nothing.

Entries are safetensors files, so opening a stranger's folder runs no code. An entry that cannot be
read is an error that names the file: deleting `cache/` is always safe.
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

import edit3r
from edit3r.errors import InputError
from edit3r.plugins.weights import at_hand
from edit3r.reporting import note

Method = TypeVar("Method", bound=Callable)
SUFFIX = ".safetensors"


class Cache:
    """Answers by key, in memory and, where a folder is given, in the files of an earlier run."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._entries: dict[str, tuple[dict[str, Tensor], str]] = {}
        self.reused: list[str] = []
        self.computed: list[str] = []

    def recall(self, name: str, key: str, compute: Callable[[], Any]) -> Any:
        """Return the answer called `name` that is kept under `key`, computing it where it is not
        known.
        """
        entry = f"{name}-{key}"
        known = self._entries.get(entry) or self._read(entry)
        if known is not None:
            self._entries[entry] = known
            self._count(self.reused, name)
            return _unpack(json.loads(known[1]), known[0])
        answer = compute()
        tensors: dict[str, Tensor] = {}
        tree = _pack(answer, tensors)
        # Copies: whoever gets the answer may write into it.
        self._entries[entry] = (
            {key: value.detach().clone() for key, value in tensors.items()},
            json.dumps(tree),
        )
        self._count(self.computed, name)
        return answer

    def save(self, folder: Path) -> None:
        """Write every answer that this run asked for into `folder`."""
        from safetensors.torch import save

        folder.mkdir(parents=True, exist_ok=True)
        for entry, (tensors, tree) in self._entries.items():
            contiguous = {
                name: value.cpu().contiguous() for name, value in tensors.items()
            }
            # The answer's structure travels as text in a tensor of bytes.
            contiguous["tree"] = torch.frombuffer(
                bytearray(tree.encode()), dtype=torch.uint8
            )
            (folder / f"{entry}{SUFFIX}").write_bytes(save(contiguous))

    def _read(self, entry: str) -> tuple[dict[str, Tensor], str] | None:
        from safetensors.torch import load

        file = self._folder / f"{entry}{SUFFIX}" if self._folder is not None else None
        if file is None or not file.is_file():
            return None
        try:
            tensors = load(file.read_bytes())
            tree = bytes(tensors.pop("tree").tolist()).decode()
            _unpack(json.loads(tree), tensors)
        except Exception as error:  # safetensors has no error class of its own
            reason = " ".join(str(error).split())
            raise InputError(
                f"{file}: cannot be read ({reason}); delete it, and its content is computed again."
            ) from None
        return tensors, tree

    def _count(self, names: list[str], name: str) -> None:
        names.append(name)
        note("cache.reused", list(self.reused))
        note("cache.computed", list(self.computed))


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
    `edit3r.contract.types` and `edit3r.contract.interfaces`.
    """

    @functools.wraps(method)
    def wrapper(component: Any, *args: Any, **kwargs: Any) -> Any:
        cache = _current.get()
        if cache is None:
            return method(component, *args, **kwargs)
        key = fingerprint(identity(component), method.__qualname__, args, kwargs)
        return cache.recall(
            method.__name__, key, lambda: method(component, *args, **kwargs)
        )

    return wrapper


def recall(
    name: str, component: Any, arguments: Any, compute: Callable[[], Any]
) -> Any:
    """Return what `compute` gives for a component and its arguments, by the current run's cache
    where there is one.
    """
    cache = _current.get()
    return (
        compute()
        if cache is None
        else cache.recall(
            name, fingerprint(identity(component), name, arguments), compute
        )
    )


def fingerprint(*things: Any) -> str:
    """Return the hex digest of tensors, data classes, texts, numbers, None, and sequences and
    mappings of them.
    """
    digest = hashlib.blake2b(digest_size=16)
    for thing in things:
        _add(digest, thing)
    return digest.hexdigest()


def identity(component: Any) -> str:
    """Return a digest of all that a component's answers depend on besides its arguments.

    These are its name, plugin and version, its source file, settings, parts, the weights of its
    network, and which of the weights that it declares are at hand. A change in another file of the
    plugin, without a new version, goes unnoticed.
    """
    offer = getattr(component, "offer", None)
    who = (
        (offer.qualified_name, offer.version)
        if offer is not None
        else (type(component).__qualname__, "")
    )
    learned = (
        []
        if offer is None
        else [one.name for one in offer.component.weights if at_hand(one) is not None]
    )
    settings = getattr(component, "settings", None)
    values = settings.model_dump_json() if settings is not None else ""
    parts = sorted((getattr(component, "parts", None) or {}).items())
    inner = [(kind, identity(part)) for kind, part in parts]
    source = _source_digest(type(component))
    return fingerprint(
        edit3r.__version__, who, source, values, inner, learned, _weight_sums(component)
    )


def _add(digest: "hashlib._Hash", thing: Any) -> None:
    if isinstance(thing, Tensor):
        values = thing.detach().cpu().contiguous()
        digest.update(f"{values.dtype}{list(values.shape)}".encode())
        digest.update(
            values.flatten().view(torch.uint8).numpy() if values.numel() else b""
        )
    elif dataclasses.is_dataclass(thing):
        fields = [
            field.name for field in dataclasses.fields(thing) if field.name != "names"
        ]  # names change no answer
        _add(digest, {name: getattr(thing, name) for name in fields})
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
        return hashlib.blake2b(
            Path(inspect.getfile(cls)).read_bytes(), digest_size=16
        ).hexdigest()
    except (OSError, TypeError):  # a class made in a console has no file
        return ""


def _weight_sums(component: Any) -> list[tuple[str, float, float]]:
    """Two sums per tensor of the network: training changes them, and a large network is read in a
    second.
    """
    network = getattr(component, "network", None)
    if network is None:
        return []
    floats = (
        (name, value.detach())
        for name, value in network.state_dict().items()
        if value.is_floating_point()
    )
    return [
        (name, float(v.sum(dtype=torch.float64)), float(v.double().square().sum()))
        for name, v in floats
    ]


def _pack(value: Any, tensors: dict[str, Tensor]) -> Any:
    """Turn an answer into JSON data; its tensors go into `tensors`, under numbers that stand in
    their place.
    """
    if isinstance(value, Tensor):
        tensors[str(len(tensors))] = value
        return {"tensor": str(len(tensors) - 1)}
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
    return _storable()[tree["class"]](
        **{name: _unpack(item, tensors) for name, item in tree["fields"].items()}
    )


@functools.cache
def _storable() -> dict[str, type]:
    """The data classes that an answer may hold, by name: those of the contract."""
    from edit3r.contract import interfaces, types

    found = [
        value
        for module in (types, interfaces)
        for value in vars(module).values()
        if isinstance(value, type)
    ]
    return {cls.__name__: cls for cls in found if dataclasses.is_dataclass(cls)}
