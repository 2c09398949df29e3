"""A filter of system calls (seccomp) for confined processes, on x86-64.

It allows what numerical Python needs: memory, files, threads, clocks and the socket to the verifier. It refuses every
other call, so a process cannot change or signal another one, and cannot change metadata or lock files, which Landlock
does not cover.
"""

from __future__ import annotations

import ctypes
import errno
import os
import struct
from collections.abc import Sequence
from typing import NamedTuple

MACHINE = "x86_64"
"""The processor that the numbers below are of."""
ALLOWED = {
    "read": 0, "write": 1, "close": 3, "stat": 4, "fstat": 5, "lstat": 6, "poll": 7, "lseek": 8, "mmap": 9,
    "mprotect": 10, "munmap": 11, "brk": 12, "rt_sigaction": 13, "rt_sigprocmask": 14, "rt_sigreturn": 15,
    "pread64": 17, "pwrite64": 18, "readv": 19, "writev": 20, "access": 21, "pipe": 22, "select": 23,
    "sched_yield": 24, "mremap": 25, "msync": 26, "madvise": 28, "dup": 32, "dup2": 33, "nanosleep": 35, "getpid": 39,
    "sendto": 44, "recvfrom": 45, "exit": 60, "uname": 63, "fsync": 74, "fdatasync": 75, "ftruncate": 77,
    "getdents": 78, "getcwd": 79, "chdir": 80, "fchdir": 81, "rename": 82, "mkdir": 83, "rmdir": 84, "unlink": 87,
    "readlink": 89, "umask": 95, "gettimeofday": 96, "getrlimit": 97, "getrusage": 98, "times": 100, "getuid": 102,
    "getgid": 104, "geteuid": 107, "getegid": 108, "getppid": 110, "sigaltstack": 131, "arch_prctl": 158,
    "gettid": 186, "time": 201, "futex": 202, "sched_getaffinity": 204, "epoll_create": 213, "getdents64": 217,
    "set_tid_address": 218, "restart_syscall": 219, "clock_gettime": 228, "clock_getres": 229, "clock_nanosleep": 230,
    "exit_group": 231, "epoll_wait": 232, "epoll_ctl": 233, "mkdirat": 258, "newfstatat": 262, "unlinkat": 263,
    "renameat": 264, "readlinkat": 267, "faccessat": 269, "pselect6": 270, "ppoll": 271, "set_robust_list": 273,
    "epoll_pwait": 281, "eventfd2": 290, "epoll_create1": 291, "dup3": 292, "pipe2": 293, "getcpu": 309,
    "renameat2": 316, "getrandom": 318, "membarrier": 324, "statx": 332, "rseq": 334, "faccessat2": 439,
}  # fmt: skip
"""Numbers of the system calls that are allowed with all arguments."""


class Rule(NamedTuple):
    """A system call that is allowed if some bits of an argument have one of these values."""

    number: int
    argument: int
    values: Sequence[int]
    bits: int = 0xFFFFFFFF


_WRITE_ONLY, _READ_WRITE, _TRUNCATE = 0o1, 0o2, 0o1000
_OPEN_MODES = [0, *(mode | cut for mode in (_WRITE_ONLY, _READ_WRITE) for cut in (0, _TRUNCATE))]
"""All but truncation of a file that is opened to be read, which Landlock covers from version 3 of its interface on."""
_OPEN_BITS = 0o3 | _TRUNCATE
_TERMINAL = 0x5401
"""TCGETS, by which a C library finds out whether a file is a terminal."""
_N_READABLE, _NON_BLOCKING, _KEEP_ON_EXEC, _CLOSE_ON_EXEC = 0x541B, 0x5421, 0x5450, 0x5451
_DUPLICATE, _GET_DESCRIPTOR_FLAGS, _SET_DESCRIPTOR_FLAGS, _GET_FLAGS, _DUPLICATE_CLOSE_ON_EXEC = 0, 1, 2, 3, 1030
_THREAD, _SET_NAME, _THIS_PROCESS = 0x10000, 15, 0
RULES = {
    "open": Rule(2, 1, _OPEN_MODES, _OPEN_BITS),
    "ioctl": Rule(16, 1, (_TERMINAL, _N_READABLE, _NON_BLOCKING, _KEEP_ON_EXEC, _CLOSE_ON_EXEC)),
    "clone": Rule(56, 0, (_THREAD,), _THREAD),
    "fcntl": Rule(
        72, 1, (_DUPLICATE, _GET_DESCRIPTOR_FLAGS, _SET_DESCRIPTOR_FLAGS, _GET_FLAGS, _DUPLICATE_CLOSE_ON_EXEC)
    ),
    "prctl": Rule(157, 0, (_SET_NAME,)),
    "openat": Rule(257, 2, _OPEN_MODES, _OPEN_BITS),
    "prlimit64": Rule(302, 0, (_THIS_PROCESS,)),
}
"""System calls of which some arguments are allowed: threads but no processes, limits of this process alone."""
FIRST_UNKNOWN = 424
"""The first number of newer system calls. A C library uses an older one instead where these do not exist."""
_X32, _AUDIT_ARCH = 0x40000000, 0xC000003E
_LOAD, _EQUAL, _AT_LEAST, _AND, _RETURN = 0x20, 0x15, 0x35, 0x54, 0x06
_ALLOW, _ERROR, _KILL = 0x7FFF0000, 0x00050000, 0x80000000
_SECCOMP, _FILTER = 22, 2


def filter_system_calls(libc: ctypes.CDLL) -> int:
    """Install the filter, which needs "no new privileges"; below 0 where the system refuses."""
    filters = [
        (_LOAD, 0, 0, 4), (_EQUAL, 1, 0, _AUDIT_ARCH), (_RETURN, 0, 0, _KILL), (_LOAD, 0, 0, 0),
        (_AT_LEAST, 0, 1, _X32), (_RETURN, 0, 0, _KILL),
    ]  # fmt: skip
    for number in ALLOWED.values():
        filters += [(_EQUAL, 0, 1, number), (_RETURN, 0, 0, _ALLOW)]
    for rule in RULES.values():
        checks = [(_LOAD, 0, 0, 16 + 8 * rule.argument), (_AND, 0, 0, rule.bits)]
        for value in rule.values:
            checks += [(_EQUAL, 0, 1, value), (_RETURN, 0, 0, _ALLOW)]
        checks.append((_RETURN, 0, 0, _ERROR | errno.EPERM))
        filters += [(_EQUAL, 0, len(checks), rule.number), *checks]
    filters += [
        (_AT_LEAST, 0, 1, FIRST_UNKNOWN), (_RETURN, 0, 0, _ERROR | errno.ENOSYS),
        (_RETURN, 0, 0, _ERROR | errno.EPERM),
    ]  # fmt: skip
    program = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *one) for one in filters))
    described = ctypes.create_string_buffer(struct.pack("HxxxxxxP", len(filters), ctypes.addressof(program)))
    return libc.prctl(_SECCOMP, _FILTER, described, 0, 0)


def is_supported() -> bool:
    """Whether the numbers are of this processor."""
    return os.uname().machine == MACHINE
