"""How much memory there is, and refusing what does not fit before anything is allocated."""

import os
from pathlib import Path

from cellpilot.errors import InputError

MEMORY_INFO, LIMIT = Path("/proc/meminfo"), Path("/sys/fs/cgroup/memory.max")


def available_bytes() -> int | None:
    """Memory that can be had without swapping, a container's limit respected; None where the system does not tell."""
    found = []
    if MEMORY_INFO.is_file():
        fields = dict(line.split(":", 1) for line in MEMORY_INFO.read_text().splitlines() if ":" in line)
        found += [1024 * int(fields[name].split()[0]) for name in ("MemAvailable",) if name in fields]
    elif "SC_PHYS_PAGES" in getattr(os, "sysconf_names", ()):
        found.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    if LIMIT.is_file() and (limit := LIMIT.read_text().strip()).isdigit():
        found.append(int(limit))
    return min(found, default=None)


def check_memory(needed_bytes: int, what: str, remedy: str) -> None:
    """`InputError` with both figures if `what` needs more memory than there is."""
    available = available_bytes()
    if available is not None and needed_bytes > available:
        figures = f"{needed_bytes / 1e9:.3g} GB, {available / 1e9:.3g} GB are available"
        raise InputError(f"{what} needs {figures}: {remedy}")
