"""A second device on any machine, so that code which mixes devices is found without a GPU.

    with second_device() as device:
        views = edit3r_testing.photograph(2).views.to(device)
        edit3r.build("editor", "sepia").edit(views, request)  # raises where devices are mixed

Tensors there keep their numbers in the CPU's memory. As on a GPU, an operation on tensors of two
devices raises RuntimeError, and numpy takes none of them.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves, tree_map

DEVICE = torch.device("meta")  # the one device of every torch that holds no numbers
MOVES = ("aten::copy_", "aten::_to_copy")  # operations between devices
TAKES_INDICES = "aten::index"  # with indices on the CPU too


@contextmanager
def second_device() -> Iterator[torch.device]:
    """Inside the block, in threads that start there too, the device that it gives holds numbers."""
    run = threading.Thread.run

    def run_there(thread: threading.Thread) -> None:
        with _Functions(), _Operations():
            run(thread)

    threading.Thread.run = run_there  # type: ignore[method-assign]
    try:
        with _Functions(), _Operations():
            yield DEVICE
    finally:
        threading.Thread.run = run  # type: ignore[method-assign]


class _There(Tensor):
    """A tensor of the second device around one of the CPU, `held`."""

    held: Tensor
    __torch_function__ = torch._C._disabled_torch_function_impl

    @staticmethod
    def __new__(cls, held: Tensor) -> "_There":
        made = Tensor._make_wrapper_subclass(
            cls,
            held.size(),
            strides=held.stride(),
            storage_offset=held.storage_offset(),
            dtype=held.dtype,
            layout=held.layout,
            device=DEVICE,
            requires_grad=held.requires_grad,
        )
        made.held = held
        return made

    @classmethod
    def __torch_dispatch__(
        cls, func: Any, types: Any, args: tuple = (), kwargs: dict | None = None
    ) -> Any:
        return _operate(func, args, kwargs or {})


class _Operations(TorchDispatchMode):
    def __torch_dispatch__(
        self, func: Any, types: Any, args: tuple = (), kwargs: dict | None = None
    ) -> Any:
        return _operate(func, args, kwargs or {})


class _Functions(TorchFunctionMode):
    """What torch does in Python with numbers, before any operation."""

    def __torch_function__(
        self, func: Any, types: Any, args: tuple = (), kwargs: dict | None = None
    ) -> Any:
        kwargs = dict(kwargs or {})
        if args and isinstance(args[0], _There):
            there, *rest = args
            if func is Tensor.tolist:
                return there.held.tolist()
            if func in (Tensor.numpy, Tensor.__array__):
                return _as_array(there, **kwargs)
            if func is Tensor.new_tensor:
                kwargs = {"device": DEVICE, "dtype": there.dtype, **kwargs}
                func, args = torch.tensor, tuple(rest)
            if func in (Tensor.__getitem__, Tensor.__setitem__):
                args = (there, _indices(rest[0]), *rest[1:])
        made_of_numbers = func in (torch.tensor, torch.as_tensor)
        if made_of_numbers and str(kwargs.get("device")) == str(DEVICE):
            return _put(func(*args, **{**kwargs, "device": "cpu"}))
        return func(*args, **kwargs)


def _operate(func: Any, args: tuple, kwargs: dict) -> Any:
    """Do an operation on what the tensors hold; its answer is where torch would put it."""
    given = tree_leaves((args, kwargs))
    name = func._schema.name
    there = any(isinstance(value, _There) for value in given)
    here = any(
        isinstance(value, Tensor) and not isinstance(value, _There) and value.dim()
        for value in given
    )
    takes_both = name in MOVES or (
        name.startswith(TAKES_INDICES) and isinstance(args[0], _There)
    )
    if there and here and not takes_both:
        raise RuntimeError(
            f"Expected all tensors to be on the same device, but found at least two devices, "
            f"{DEVICE} and cpu, in {name}."
        )
    target = kwargs.get("device")
    if target is not None:
        there = torch.device(target) == DEVICE
        if there and any(isinstance(one, torch.Generator) for one in given):
            raise RuntimeError(
                f"Expected a generator of device {DEVICE} but found one of the CPU in {name}."
            )
        kwargs = {**kwargs, "device": torch.device("cpu")}
    answer = func(*tree_map(_held, args), **tree_map(_held, kwargs))
    if func._schema.is_mutable and isinstance(answer, Tensor):
        return next((one for one in given if _held(one) is answer), answer)
    return tree_map(_put, answer) if there else answer


def _as_array(there: _There, *, force: bool = False, **_: Any) -> Any:
    if not force:
        raise TypeError(
            f"can't convert a tensor of device {DEVICE} to numpy. Use Tensor.cpu() first."
        )
    return there.held.numpy(force=True)


def _indices(index: Any) -> Any:
    """Lists of indices as tensors of the CPU: torch would put them where there are no numbers."""
    if isinstance(index, tuple):
        return tuple(map(_indices, index))
    if not isinstance(index, list | range):
        return index
    return torch.tensor(list(index), dtype=None if len(index) else torch.long)


def _held(value: Any) -> Any:
    return value.held if isinstance(value, _There) else value


def _put(value: Any) -> Any:
    """A tensor on the second device; anything else as it is."""
    is_here = isinstance(value, Tensor) and not isinstance(value, _There)
    return _There(value) if is_here else value
