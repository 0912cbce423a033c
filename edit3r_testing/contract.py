"""What every contract shares: building the component, and reporting a violation.

A contract is a class whose `test_*` methods each hold one claim about a component. pytest runs a
subclass that names the component. This module needs no pytest.
"""

import subprocess
import sys
import unittest
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import torch

from edit3r.contract.hookspecs import API_VERSION
from edit3r.contract.types import Gaussians
from edit3r.plugins.check import check_offer
from edit3r.plugins.load import Offer
from edit3r.plugins.registry import (
    Registry,
    absent_device,
    default_registry,
    install_hint,
)

HEAVY = (
    "torch",
    "numpy",
    "cv2",
    "kornia",
    "skimage",
    "scipy",
    "numba",
    "transformers",
    "diffusers",
)
"""Modules a plugin's declaration must not import: every command would wait for them."""

GAUSSIAN_FIELDS = ("means", "scales", "quats", "opacities", "harmonics")


class ContractViolation(AssertionError):
    """A component broke its contract; the message says what its author has to change."""


class Contract:
    """Base of the contract of each kind. Name the component in a subclass called `Test...`."""

    kind: ClassVar[str] = ""
    component: ClassVar[str] = (
        ""  # "sepia", or "plugin:sepia" where two plugins offer the name
    )
    settings: ClassVar[Mapping[str, Any]] = {}  # what the component is built with
    parts: ClassVar[
        Mapping[str, Any]
    ] = {}  # parts to use instead of those its settings name
    plugin_files: ClassVar[
        tuple[str | Path, ...]
    ] = ()  # local plugin files or folders to load first
    _subject: ClassVar[Any] = None

    def build(self) -> Any:
        """A fresh component. Override to test an object that no plugin offers yet."""
        if not self.component:
            raise ContractViolation(
                f"{type(self).__name__}: set `component` to the name your plugin offers."
            )
        self._skip_unless_usable()
        return self.registry.build(
            self.kind, self.component, dict(self.parts), **self.settings
        )

    @property
    def subject(self) -> Any:
        """The component under test, built once for all claims of a class."""
        cls = type(self)
        if "_subject" not in cls.__dict__:
            cls._subject = self.build()
        return cls._subject

    @property
    def registry(self) -> Registry:
        return default_registry(tuple(str(file) for file in self.plugin_files))

    @property
    def offer(self) -> Offer | None:
        """What the plugin declared; None for an object that no plugin offers."""
        return self.registry.find(self.kind, self.component) if self.component else None

    @property
    def device(self) -> torch.device:
        """Where the claims run: the CPU, or what a component needs instead."""
        devices = self.offer.component.devices if self.offer else ()
        return torch.device("cpu" if "cpu" in devices or not devices else devices[0])

    @property
    def tolerance(self) -> float:
        """How far two runs with the same inputs may differ: not at all on a CPU, 1e-5 on a GPU."""
        return 0.0 if self.device.type == "cpu" else 1e-5

    def require(self, held: bool, change: str) -> None:
        """Raise ContractViolation with the sentence `change` unless `held`."""
        __tracebackhide__ = True
        if not bool(held):
            raise ContractViolation(
                f"{self.kind} {self.component or type(self).__name__!r}: {change}"
            )

    def require_type(self, what: str, value: Any, expected: type, instead: str) -> None:
        """`what` ("edit() returned", "gaussians is") says where the value comes from, `instead`
        what it should be.
        """
        __tracebackhide__ = True
        self.require(
            isinstance(value, expected),
            f"{what} a {type(value).__name__}; return {instead}.",
        )

    def call(
        self, what: str, function: Callable[..., Any], *args: Any, **kwargs: Any
    ) -> Any:
        """Call the component; whatever it raises becomes a violation that says for which input."""
        __tracebackhide__ = True
        try:
            return function(*args, **kwargs)
        except Exception as error:
            reason = " ".join(str(error).split())
            fix = (
                "Return the shape expected"
                if "expected shape" in reason
                else "It must handle this input"
            )
            self.require(
                False, f"{what} raised {type(error).__name__}: {reason}. {fix}."
            )

    def require_tensor(
        self,
        name: str,
        tensor: Any,
        shape: tuple[int, ...],
        dtype: torch.dtype = torch.float32,
    ) -> None:
        """A finite tensor of this shape and dtype on the contract's device."""
        __tracebackhide__ = True
        self.require_type(f"{name} is", tensor, torch.Tensor, "a torch.Tensor")
        given = list(tensor.shape)
        self.require(
            given == list(shape), f"{name} has shape {given}; return {list(shape)}."
        )
        self.require(
            tensor.dtype == dtype,
            f"{name} has dtype {tensor.dtype}; return the dtype of the input, {dtype}.",
        )
        self.require(
            tensor.device.type == self.device.type,
            f"{name} is on {tensor.device}; return it on {self.device}.",
        )
        if tensor.is_floating_point():
            bad = int((~torch.isfinite(tensor)).sum())
            where = "look for 0/0, log(0) and sqrt of negative numbers"
            self.require(
                bad == 0,
                f"{name} holds {bad} NaN or infinite values of {tensor.numel()}; {where}.",
            )

    def require_range(
        self, name: str, tensor: torch.Tensor, low: float, high: float, fix: str
    ) -> None:
        """Every value within [low, high]; `fix` is what the author should do."""
        __tracebackhide__ = True
        if tensor.numel() == 0:
            return
        least, most = tensor.min().item(), tensor.max().item()
        self.require(
            low <= least and most <= high,
            f"{name} spans [{least:.4g}, {most:.4g}], allowed is [{low}, {high}]; {fix}.",
        )

    def require_equal(
        self,
        what: str,
        first: torch.Tensor,
        second: torch.Tensor,
        fix: str,
        atol: float = 0.0,
    ) -> None:
        """Same shape and values within `atol`."""
        __tracebackhide__ = True
        same_shape = first.shape == second.shape
        far = (
            (first.double() - second.double()).abs().max().item()
            if same_shape and first.numel()
            else 0.0
        )
        self.require(
            same_shape and far <= atol, f"{what} (largest difference {far:.3g}); {fix}."
        )

    def _skip_unless_usable(self) -> None:
        offer = self.offer
        missing = self.registry.missing(offer)
        if missing:
            raise unittest.SkipTest(
                f"needs {', '.join(missing)}; {install_hint(offer)}"
            )
        absent = absent_device(offer.component)
        if absent:
            raise unittest.SkipTest(f"needs {absent}, which this machine does not have")

    # ---- claims about every kind of component ----

    def test_declaration_keeps_its_promises(self) -> None:
        """The class exists, follows the interface, and every setting has a description."""
        if self.offer is not None:
            problem = check_offer(self.registry, self.offer)
            if problem:
                raise ContractViolation(problem)

    def test_declaration_states_the_api_version(self) -> None:
        """So that a future edit3r can say what to update instead of failing somewhere inside."""
        module = sys.modules.get(self.offer.module) if self.offer is not None else None
        if module is not None:
            stated = hasattr(module, "EDIT3R_API")
            self.require(
                stated,
                f"{self.offer.module} does not state EDIT3R_API; add `EDIT3R_API = {API_VERSION}`.",
            )

    def test_declaration_imports_nothing_heavy(self) -> None:
        """`edit3r --help` and `list-plugins` import every plugin's declaration, so it must be
        cheap.
        """
        if self.offer is None or self.offer.module == "" or self.plugin_files:
            return
        fix = "move that import to the component's module"
        self.require_light(
            f"importing {self.offer.module}", f"import {self.offer.module}", fix
        )

    def require_light(self, what: str, code: str, fix: str) -> None:
        """Run `code` in a fresh process; it must not import anything heavy."""
        loaded, failure = _heavy_imports(code)
        self.require(not failure, f"{what} fails: {failure}")
        self.require(not loaded, f"{what} imports {loaded}; {fix}.")


@cache
def _heavy_imports(code: str) -> tuple[str, str]:
    """The heavy modules that `code` imports in a process of its own, and why it fails, else ''."""
    code = f"{code}\nimport sys; print(*[module for module in {HEAVY!r} if module in sys.modules])"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    failure = done.stderr.strip()[-200:] or f"exit code {done.returncode}"
    return ", ".join(done.stdout.split()), failure if done.returncode else ""


def claims(contract: type[Contract]) -> tuple[str, ...]:
    """Names of the claims of a contract, in the order they are written, the common ones first."""
    names = [
        name
        for cls in reversed(contract.__mro__)
        for name in vars(cls)
        if name.startswith("test_")
    ]
    return tuple(dict.fromkeys(names))


def require_valid_gaussians(
    contract: Contract, gaussians: Gaussians, batch: int, view_count: int
) -> None:
    """Finite, unit quaternions, positive scales, opacities in [0, 1], view numbers of existing
    views.
    """
    contract.require_type("gaussians is", gaussians, Gaussians, "edit3r.Gaussians")
    contract.require(
        gaussians.count > 0, "there is not one Gaussian; return at least one per scene."
    )
    for name in GAUSSIAN_FIELDS:
        tensor = getattr(gaussians, name)
        contract.require_tensor(f"Gaussians.{name}", tensor, (batch, *tensor.shape[1:]))
    norms = gaussians.quats.norm(dim=-1)
    contract.require_range(
        "norms of Gaussians.quats",
        norms,
        0.999,
        1.001,
        "normalise them, F.normalize(quats, dim=-1)",
    )
    contract.require_range(
        "Gaussians.opacities",
        gaussians.opacities,
        0,
        1,
        "squash them, for example with .sigmoid()",
    )
    least = gaussians.scales.min().item()
    contract.require(
        least > 0,
        f"the least of Gaussians.scales is {least:.4g}; use exp or softplus, they must be > 0.",
    )
    index = gaussians.view_index
    contract.require(
        bool(((index >= -1) & (index < view_count)).all()),
        f"Gaussians.view_index spans [{index.min()}, {index.max()}] for {view_count} views; "
        "it is the input view a Gaussian came from, or -1.",
    )


def require_same_gaussians(
    contract: Contract,
    what: str,
    first: Gaussians,
    second: Gaussians,
    fix: str,
    atol: float,
):
    """Every field agrees, relative to its largest value."""
    contract.require(
        first.count == second.count,
        f"{what}: {first.count} against {second.count} Gaussians per scene; {fix}.",
    )
    for name in GAUSSIAN_FIELDS:
        a, b = getattr(first, name), getattr(second, name)
        size = max(1e-8, torch.nan_to_num(b).abs().max().item())
        contract.require_equal(
            f"{what}, Gaussians.{name}", a / size, b / size, fix, atol
        )
