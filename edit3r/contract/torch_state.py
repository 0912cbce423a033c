"""torch as edit3r expects it, whatever the caller has set: float32, the CPU as default device, no
autocast, no inference mode; and the devices that it can use.
"""

import functools
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import fields, is_dataclass, replace
from typing import TYPE_CHECKING, Any, TypeVar

from edit3r.contract.errors import SettingsError, one_line

if TYPE_CHECKING:
    import torch

Function = TypeVar("Function", bound=Callable[..., Any])
_AUTOCAST = ("cpu", "cuda")  # devices of which it is switched off


def in_usual_torch(function: Function) -> Function:
    """The function, called in `usual_torch`, with arguments that were made in inference mode
    copied: those cannot take part in gradients.

    Every call that programs of others make goes through here. Whether gradients are kept is left
    as it is.
    """

    @functools.wraps(function)
    def called(*args: Any, **kwargs: Any) -> Any:
        if "torch" not in sys.modules:  # a state that nobody can have changed
            return function(*args, **kwargs)
        with usual_torch():
            normal = {name: _normal(value) for name, value in kwargs.items()}
            return function(*map(_normal, args), **normal)

    return called  # type: ignore[return-value]


@contextmanager
def usual_torch() -> Iterator[None]:
    """torch's state as it is without settings; the caller's comes back after the block."""
    import torch

    dtype = torch.get_default_dtype()
    with ExitStack() as stack:
        if torch.is_inference_mode_enabled():
            stack.enter_context(torch.inference_mode(False))
            stack.enter_context(torch.no_grad())
        for device in _AUTOCAST:
            if torch.is_autocast_enabled(device):
                stack.enter_context(torch.autocast(device, enabled=False))
        if torch.get_default_device().type != "cpu":
            stack.enter_context(torch.device("cpu"))
        if dtype != torch.float32:
            torch.set_default_dtype(torch.float32)
            stack.callback(torch.set_default_dtype, dtype)
        _settle_logarithms()
        yield


@functools.cache
def _settle_logarithms() -> None:
    """Make the logarithms of this process the same bits on every thread.

    The first one that MKL computes on several threads is sometimes less accurate in one of them,
    and then the same seed does not give the same bytes. After a small one on one thread none is.
    """
    import torch

    torch.log(torch.ones(1))


def _normal(value: Any) -> Any:
    from torch import Tensor

    if isinstance(value, Tensor):
        return value.clone() if value.is_inference() else value
    if isinstance(value, list | tuple) and any(
        isinstance(one, Tensor) for one in value
    ):
        return type(value)(map(_normal, value))
    if is_dataclass(value) and not isinstance(value, type):
        values = {
            field.name: getattr(value, field.name)
            for field in fields(value)
            if field.init
        }
        changed = {name: _normal(one) for name, one in values.items()}
        changed = {
            name: one for name, one in changed.items() if one is not values[name]
        }
        return replace(value, **changed) if changed else value
    return value


def require_device(name: str, key: str = "--device") -> "torch.device":
    """The device called `name`; SettingsError, naming `key`, where torch cannot use it."""
    import torch

    try:
        empty = torch.empty(1, device=torch.device(name))
        empty.cpu()  # raises on "meta", which holds no numbers
        return empty.device
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = one_line(error, 200)
        way_out = f"{key} cpu" if key.startswith("--") else f"--set {key}=cpu"
        raise SettingsError(
            f"{key}: {name!r} cannot be used on this machine ({reason}); use {way_out}."
        ) from None
