"""Memory: what this machine has left, and what this process took."""

from pathlib import Path


def available_memory() -> int | None:
    """Memory that programs may still take [bytes]; None where the system does not tell."""
    table = Path("/proc/meminfo")
    lines = table.read_text(encoding="ascii").splitlines() if table.is_file() else []
    return next(
        (
            int(line.split()[1]) * 1024
            for line in lines
            if line.startswith("MemAvailable:")
        ),
        None,
    )


def peak_memory_mb() -> float:
    """Peak resident memory of this process so far [MiB]; 0 where the platform does not tell."""
    status = Path("/proc/self/status")
    if (
        status.is_file()
    ):  # Linux's getrusage counts what the parent process had when it started this one
        for line in status.read_text(encoding="utf-8").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024
    try:
        import resource
        import sys
    except ImportError:  # Windows
        return 0.0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024 * 1024 if sys.platform == "darwin" else 1024)
