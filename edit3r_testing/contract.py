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
from torch import Tensor

from edit3r.contract.component import Offer
from edit3r.contract.errors import Edit3rError, PluginError, UnknownComponentError
from edit3r.contract.hookspecs import API_VERSION
from edit3r.contract.types import PER_GAUSSIAN, Gaussians
from edit3r.kit.checks import errors_named_after, named_after
from edit3r.kit.children import PYTHON
from edit3r.loading.check import check_offer
from edit3r.loading.registry import (
    Registry,
    absent_device,
    default_registry,
    install_hint,
)
from edit3r_testing.scenes import Photographed, photograph

_HEAVY = "torch numpy cv2 kornia skimage scipy numba transformers diffusers"
HEAVY = tuple(_HEAVY.split())
"""Modules a plugin's declaration must not import: every command would wait for them."""


class ContractViolation(AssertionError):
    """A component broke its contract; the message says what its author has to change."""


class Contract:
    """Base of the contract of each kind. Name the component in a subclass called `Test...`."""

    kind: ClassVar[str] = ""
    # "sepia", or "plugin:sepia" where two plugins offer the name
    component: ClassVar[str] = ""
    settings: ClassVar[Mapping[str, Any]] = {}  # what the component is built with
    # parts to use instead of those its settings name
    parts: ClassVar[Mapping[str, Any]] = {}
    # local plugin files or folders to load first
    plugin_files: ClassVar[tuple[str | Path, ...]] = ()
    # (height, width) of test photos [pixels]
    image_size: ClassVar[tuple[int, int]] = (48, 64)
    _subject: ClassVar[Any] = None

    def build(self) -> Any:
        """A fresh component. Override to test an object that no plugin offers yet."""
        return self.build_with(self.settings)

    def build_with(self, settings: Mapping[str, Any], **parts: Any) -> Any:
        """A fresh component with these settings, and with `parts` besides those of the class."""
        if not self.component:
            raise ContractViolation(
                f"{type(self).__name__}: set `component` to the name your plugin offers."
            )
        self._skip_unless_usable()
        parts |= self.parts
        return self.registry.build(self.kind, self.component, parts, **settings)

    @property
    def subject(self) -> Any:
        """The component under test, built once for all claims of a class."""
        cls = type(self)
        if "_subject" not in cls.__dict__:
            cls._subject = self.build()
        return cls._subject

    @property
    def registry(self) -> Registry:
        return default_registry(tuple(map(str, self.plugin_files)))

    @property
    def offer(self) -> Offer | None:
        """What the plugin declared; None for an object that no plugin offers."""
        __tracebackhide__ = True
        if not self.component:
            return None
        try:
            return self.registry.find(self.kind, self.component)
        except UnknownComponentError as error:
            how = "install the package that offers it (pip install -e FOLDER), or name its folder"
            raise ContractViolation(f"{error} Yours? {how} in plugin_files.") from None

    @property
    def device(self) -> torch.device:
        """Where the claims run: the CPU, or what a component needs instead."""
        devices = self.offer.component.devices if self.offer else ()
        return torch.device("cpu" if "cpu" in devices or not devices else devices[0])

    @property
    def tolerance(self) -> float:
        """How far two runs with the same inputs may differ: not at all on a CPU, 1e-5 on a GPU."""
        return 0.0 if self.device.type == "cpu" else 1e-5

    def scene(
        self, views: int = 2, batch: int = 1, size: tuple[int, int] | None = None
    ) -> Photographed:
        """Test photos and what is true of them, on the contract's device."""
        return photograph(views, size or self.image_size, batch).to(self.device)

    def require(self, held: Any, change: str) -> None:
        """Raise ContractViolation with the sentence `change` unless `held`."""
        __tracebackhide__ = True
        if not bool(held):
            who = self.component or type(self).__name__
            raise ContractViolation(f"{self.kind} {who!r}: {change}")

    def ask(self, how: Callable[..., Any], *given: Any, subject: Any = None) -> Any:
        """What the component answers to `how`, a function of `edit3r.kit.asking`, as in a run.

        What it raises, and a promise that it breaks, is a violation in the run's own words.
        """
        __tracebackhide__ = True
        asked = self.subject if subject is None else subject
        return self.call(how, asked, *given, subject=asked)

    def call(
        self, function: Callable[..., Any], *given: Any, subject: Any = None
    ) -> Any:
        """What `function` of the component returns; what it raises is a violation."""
        __tracebackhide__ = True
        subject = self.subject if subject is None else subject
        try:
            with errors_named_after(subject):
                return function(*given)
        except PluginError as error:
            raise ContractViolation(str(error)) from error
        except Edit3rError as error:
            told = f"{named_after(subject)} refused what it must handle: {error}"
            raise ContractViolation(told) from error

    def require_type(self, what: str, value: Any, expected: type) -> None:
        """`what` is where the value comes from, such as "propose()"."""
        __tracebackhide__ = True
        self.require(
            isinstance(value, expected),
            f"{what} is a {type(value).__name__}; return {expected.__name__}.",
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
        self.require_type(name, tensor, Tensor)
        for what, given, expected in (
            ("shape", list(tensor.shape), list(shape)),
            ("dtype", tensor.dtype, dtype),
            ("device", tensor.device.type, self.device.type),
        ):
            self.require(
                given == expected, f"{name} has {what} {given}; return {expected}."
            )
        bad = int((~torch.isfinite(tensor)).sum())
        where = "look for 0/0, log(0) and sqrt of negative numbers"
        self.require(
            bad == 0,
            f"{name} holds {bad} NaN or infinite values of {tensor.numel()}; {where}.",
        )

    def require_range(
        self, name: str, tensor: Tensor, low: float, high: float, fix: str
    ) -> None:
        """Every value within [low, high]; `fix` is what the author should do."""
        __tracebackhide__ = True
        if tensor.numel():
            least, most = tensor.min().item(), tensor.max().item()
            self.require(
                low <= least and most <= high,
                f"{name} spans [{least:.4g}, {most:.4g}], allowed is [{low}, {high}]; {fix}.",
            )

    def require_equal(
        self,
        what: str,
        first: Tensor | Gaussians,
        second: Tensor | Gaussians,
        fix: str,
        atol: float = 0.0,
    ) -> None:
        """Same shapes and values within `atol`; those of Gaussians relative to the largest."""
        __tracebackhide__ = True
        if isinstance(first, Gaussians):
            for name in PER_GAUSSIAN:
                a, b = getattr(first, name), getattr(second, name)
                size = max(1e-8, torch.nan_to_num(b).abs().max().item())
                self.require_equal(
                    f"{what}, Gaussians.{name}", a / size, b / size, fix, atol
                )
            return
        self.require(
            first.shape == second.shape,
            f"{what} ({list(first.shape)} against {list(second.shape)}); {fix}.",
        )
        far = (first.double() - second.double()).abs()
        largest = far.max().item() if far.numel() else 0.0
        self.require(
            largest <= atol, f"{what} (largest difference {largest:.3g}); {fix}."
        )

    def require_same_twice(self, run: Callable[[], Any], of: str, fix: str) -> None:
        """`run` gives the same again, though others draw from the global generator between."""
        __tracebackhide__ = True
        first = run()
        torch.rand(3)
        self.require_equal(
            f"the same {of} gave two results", run(), first, fix, self.tolerance
        )

    def require_untouched(self, images: Tensor, run: Callable[[], Any]) -> None:
        """`run` does not write into the images that it is given."""
        __tracebackhide__ = True
        before = images.clone()
        run()
        self.require_equal("its input was changed", images, before, "work on a copy")

    def _skip_unless_usable(self) -> None:
        offer = self.offer
        missing = ", ".join(self.registry.missing(offer))
        if missing:
            raise unittest.SkipTest(f"needs {missing}; {install_hint(offer)}")
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
        name = self.offer.module if self.offer is not None else ""
        if name in sys.modules:
            self.require(
                hasattr(sys.modules[name], "EDIT3R_API"),
                f"{name} does not state EDIT3R_API; add `EDIT3R_API = {API_VERSION}`.",
            )

    def test_declaration_imports_nothing_heavy(self) -> None:
        """Each command imports every plugin's declaration, so it must be cheap."""
        if self.offer is not None and self.offer.module and not self.plugin_files:
            statement = f"import {self.offer.module}"
            fix = "move that import to the component's module"
            self.require_light(statement, statement, fix)

    def require_light(self, what: str, code: str, fix: str) -> None:
        """Run `code` in a fresh process; it must not import anything heavy."""
        loaded, failure = _heavy_imports(code)
        self.require(not failure, f"{what} fails: {failure}")
        self.require(not loaded, f"{what} imports {loaded}; {fix}.")


@cache
def _heavy_imports(code: str) -> tuple[str, str]:
    """The heavy modules that `code` imports in a process of its own, and why it fails, else ''."""
    code += f"\nimport sys; print(*[name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run(
        [*PYTHON, "-c", code], capture_output=True, text=True, check=False
    )
    failure = done.stderr.strip()[-200:] or f"exit code {done.returncode}"
    return ", ".join(done.stdout.split()), failure if done.returncode else ""


def claims(contract: type[Contract]) -> tuple[str, ...]:
    """Names of the claims of a contract, in the order they are written, the common ones first."""
    names = [name for cls in reversed(contract.__mro__) for name in vars(cls)]
    return tuple(dict.fromkeys(name for name in names if name.startswith("test_")))
