"""Landlock: confine a process that reads other people's files to a few folders.

As a program, ``python -I landlock.py POLICY COMMAND...`` confines itself and becomes COMMAND, so that all threads
of Blender, and what it may start, are confined from their first instruction. Needs the standard library only. Where the
kernel has no Landlock, `confined` leaves the command as it is.

Landlock: unprivileged access control. The Linux Kernel documentation, userspace-api/landlock.
"""

from __future__ import annotations

import ctypes
import json
import os
import struct
import sys
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path

CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446  # the numbers of these system calls on every architecture
GET_ABI = 1  # flag of CREATE_RULESET
NO_NEW_PRIVILEGES = 38  # option of prctl
RULE_PATH_BENEATH = 1  # type of rule: a path and what is beneath it
EXECUTE, WRITE_FILE, READ_FILE, READ_FOLDER = 1, 2, 4, 8
REFER, TRUNCATE, IOCTL = 1 << 13, 1 << 14, 1 << 15
FIRST_ABI_RIGHTS = (1 << 13) - 1
RIGHTS_SINCE_ABI = {2: REFER, 3: TRUNCATE, 5: IOCTL}
NETWORK_ABI, TCP = 4, 3  # bind and connect
SCOPE_ABI, SCOPES = 6, 3  # abstract sockets and signals
SPECIAL_FILE_RIGHTS = 1 << 6 | 1 << 9 | 1 << 10 | 1 << 11 | 1 << 12  # for devices, sockets, FIFOs, links: nowhere
FILE_RIGHTS = EXECUTE | WRITE_FILE | READ_FILE | TRUNCATE | IOCTL
SYSTEM_FOLDERS = (
    *("/usr", "/bin", "/sbin", "/lib", "/lib32", "/lib64", "/nix/store"),
    *("/opt/rocm", "/opt/intel", "/run/opengl-driver"),
    *("/etc/ld.so.cache", "/etc/ld.so.conf", "/etc/ld.so.conf.d", "/etc/alternatives", "/etc/fonts", "/etc/localtime"),
    *("/etc/OpenCL", "/etc/vulkan", "/etc/glvnd", "/var/cache/fontconfig"),
    *("/proc/self", "/proc/cpuinfo", "/proc/meminfo", "/proc/stat", "/proc/version", "/proc/modules", "/proc/devices"),
    *("/proc/sys/vm", "/proc/sys/kernel", "/proc/driver", "/dev/urandom", "/dev/random"),
    *("/sys/devices", "/sys/class", "/sys/bus", "/sys/module", "/sys/fs/cgroup", "/sys/kernel/mm"),
)
PYTHON_FOLDERS = ("bin", "lib", "lib64", "share", "etc", "pyvenv.cfg")  # in Python's prefix
PACKAGE_FOLDER = Path(__file__).parents[2]
WRITABLE_DEVICES = ("/dev/null",)  # programs of every kind write to it
CONFINEMENT_VARIABLE = "HULLDOWN_CONFINEMENT"  # "off" runs processes as before there was Landlock
READABLE_VARIABLE = "HULLDOWN_READ"  # more folders to read and to run programs from, as in PATH


@cache
def landlock_version() -> int:
    """Return the kernel's version of Landlock; 0 without Landlock."""
    if not sys.platform.startswith("linux"):
        return 0
    return max(0, ctypes.CDLL(None).syscall(CREATE_RULESET, None, ctypes.c_size_t(0), ctypes.c_uint32(GET_ABI)))


def unconfined_reason() -> str:
    """Return the reason why processes aren't confined on this machine; empty if they are."""
    if not landlock_version():
        return "this kernel has no Landlock"
    return f"switched off by {CONFINEMENT_VARIABLE}" if os.environ.get(CONFINEMENT_VARIABLE, "").lower() == "off" else ""


def describe_confinement() -> str:
    """Describe the confinement on this machine for records: "Landlock 4", or why there is none."""
    return f"none: {why}" if (why := unconfined_reason()) else f"Landlock {landlock_version()}"


def confine_command(
    command: Sequence[str], *, read: Iterable[Path | str], write: Iterable[Path | str], devices: Iterable[str] = ()
) -> list[str]:
    """Return a command that runs `command` confined, or `command` itself if that's impossible or switched off."""
    if unconfined_reason():
        return list(command)
    more = [path for path in os.environ.get(READABLE_VARIABLE, "").split(os.pathsep) if path]
    program = os.path.realpath(command[0])
    policy = {
        "execute": [*SYSTEM_FOLDERS, *_python_folders(), *more, command[0], os.path.dirname(program)],
        "list": _python_search_folders(),
        "read": [*map(str, read)],
        "write": [*map(str, write), *WRITABLE_DEVICES, *devices],
    }
    return [sys.executable, "-I", "-S", os.path.abspath(__file__), json.dumps(policy), *command]


def _python_folders() -> list[str]:
    """Return the places of this Python, hulldown, and packages; other files in `sys.path`'s folders stay closed."""
    own = [f"{prefix}/{name}" for prefix in (sys.prefix, sys.base_prefix) for name in PYTHON_FOLDERS]
    return [
        *own,
        str(PACKAGE_FOLDER),
        *(str(path) for entry in _python_search_folders() for path in _installed_package_paths(entry)),
    ]


def _python_search_folders() -> list[str]:
    own = (sys.prefix, sys.base_prefix)
    entries = [entry for entry in sys.path if entry and not any(Path(entry).is_relative_to(prefix) for prefix in own)]
    return [entry for entry in entries if PACKAGE_FOLDER.parent == Path(entry) or _installed_package_paths(entry)]


@cache
def _installed_package_paths(entry: str) -> tuple[Path, ...]:
    from importlib.metadata import distributions

    files = (file for found in distributions(path=[entry]) for file in found.files or ())
    return tuple({Path(entry, file.parts[0]) for file in files if file.parts[0] != ".."})


def readable_asset_folders(path: Path) -> list[Path]:
    """Return the folders that an asset may read: its own, and the one around it unless that's home or near the root."""
    folders = [path.absolute().parent, Path(os.path.realpath(path)).parent]
    around = [folder.parent for folder in folders if len(folder.parts) > 3 and folder.parent != Path.home()]
    return list(dict.fromkeys([*folders, *around]))


def is_in_readable_folder(path: Path, folders: Iterable[Path | str]) -> bool:
    """Return whether a file, links followed, is in one of these folders or of those in ``HULLDOWN_READ``."""
    more = [folder for folder in os.environ.get(READABLE_VARIABLE, "").split(os.pathsep) if folder]
    real = Path(os.path.realpath(path))
    return any(real.is_relative_to(os.path.realpath(folder)) for folder in [*folders, *more])


def confine_this_process(policy: dict[str, list[str]]) -> None:
    """Confine this process and its children permanently. Existing threads aren't confined."""
    version = landlock_version()
    handled = FIRST_ABI_RIGHTS | sum(right for since, right in RIGHTS_SINCE_ABI.items() if version >= since)
    # A kernel takes a larger description than it knows only if the rest is zero.
    asked = struct.pack("=QQQ", handled, TCP * (version >= NETWORK_ABI), SCOPES * (version >= SCOPE_ABI))
    ruleset = _system_call(CREATE_RULESET, asked, ctypes.c_size_t(len(asked)), 0)
    reading = READ_FILE | READ_FOLDER
    rights = {
        "list": READ_FOLDER,
        "read": reading,
        "execute": reading | EXECUTE,
        "write": handled & ~(EXECUTE | SPECIAL_FILE_RIGHTS),
    }
    for kind, paths in policy.items():
        for path in paths:
            _allow_path(ruleset, path, rights[kind] & handled)
    if ctypes.CDLL(None, use_errno=True).prctl(NO_NEW_PRIVILEGES, 1, 0, 0, 0):
        raise OSError(ctypes.get_errno(), "prctl")
    _system_call(RESTRICT_SELF, ruleset, 0)
    os.close(ruleset)


def _allow_path(ruleset: int, path: str, rights: int) -> None:
    try:
        opened = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except OSError:
        return  # a missing path needs no rule
    try:
        if not os.path.isdir(path):
            rights &= FILE_RIGHTS
        _system_call(ADD_RULE, ruleset, RULE_PATH_BENEATH, struct.pack("=Qi", rights, opened), 0)
    finally:
        os.close(opened)


def _system_call(number: int, *arguments: object) -> int:
    result = int(ctypes.CDLL(None, use_errno=True).syscall(number, *arguments))
    if result < 0:
        raise OSError(ctypes.get_errno(), f"Landlock: {os.strerror(ctypes.get_errno())}")
    return result


if __name__ == "__main__":
    confine_this_process(json.loads(sys.argv[1]))
    os.execv(sys.argv[2], sys.argv[2:])
