"""Torch devices, checked where a user names one."""

import torch

from edit3r.contract.errors import SettingsError


def require_device(name: str, key: str = "--device") -> torch.device:
    """The device called `name`, such as cpu or cuda:0; SettingsError, naming `key`, where torch
    cannot use it.
    """
    try:
        empty = torch.empty(1, device=torch.device(name))
        empty.cpu()  # raises on "meta", which holds no numbers
        return empty.device
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = " ".join(str(error).split())[:200].rstrip(".")
        way_out = f"{key} cpu" if key.startswith("--") else f"--set {key}=cpu"
        raise SettingsError(
            f"{key}: {name!r} cannot be used on this machine ({reason}); use {way_out}."
        ) from None
