"""Networks in ONNX files, run by onnxruntime on the CPU."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch

from edit3r.contract.errors import InputError, one_line
from edit3r.kit.weights.load import foreign


def require_onnx_file(path: Path) -> None:
    if not path.is_file():
        raise InputError(f"{path}: is not there; expected an ONNX file.")


def onnx_session(path: Path, content: bytes, advice: str) -> Any:
    """The content of an ONNX file as a session of as many threads as torch uses.

    Raises InputError with what to do (`advice`) for what onnxruntime cannot load.
    """
    options = foreign("onnxruntime", "SessionOptions")()
    options.intra_op_num_threads = torch.get_num_threads()
    options.log_severity_level = 4  # what fails is raised as well
    options.enable_mem_pattern = False  # a third less memory, and as fast
    # Threads that wait for each other turn no circles: a third less of the processor.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    try:
        return foreign("onnxruntime", "InferenceSession")(
            content, options, providers=["CPUExecutionProvider"]
        )
    except Exception as error:  # its errors have no class in common
        raise InputError(
            f"{path}: onnxruntime cannot load it ({one_line(error, 200)}); {advice}"
        ) from None


def run_onnx(
    session: Any,
    path: Path,
    outputs: Sequence[str] | None,
    inputs: Mapping[str, Any],
    *,
    fault: str,
    advice: str,
) -> list[Any]:
    """What a session answers; None: all its outputs. Raises InputError with what is wrong with the
    file (`fault`) and what to do.
    """
    try:
        return session.run(outputs, inputs)
    except Exception as error:
        raise InputError(
            f"{path}: {fault} ({one_line(error, 200)}); {advice}"
        ) from None
