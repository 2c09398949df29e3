"""A filter of system calls (seccomp) for confined processes, on x86-64.

It refuses what starts or signals processes, and what two processes could exchange figures by: sockets, System V and
POSIX messages and shared memory, keyrings, file locks and file notifications. Landlock does not handle these.
"""

from __future__ import annotations

import ctypes
import errno
import os
import struct

MACHINE = "x86_64"
"""The processor that the numbers below are of."""
REFUSED = {
    "shmget": 29, "socket": 41, "socketpair": 53, "fork": 57, "vfork": 58, "kill": 62, "semget": 64, "msgget": 68,
    "flock": 73, "ptrace": 101, "rt_sigqueueinfo": 129, "tkill": 200, "tgkill": 234, "mq_open": 240, "add_key": 248,
    "request_key": 249, "keyctl": 250, "inotify_init": 253, "unshare": 272, "inotify_init1": 294,
    "rt_tgsigqueueinfo": 297, "perf_event_open": 298, "fanotify_init": 300, "setns": 308, "process_vm_readv": 310,
    "process_vm_writev": 311, "bpf": 321, "userfaultfd": 323, "io_uring_setup": 425, "pidfd_open": 434,
    "pidfd_getfd": 438,
}  # fmt: skip
"""Numbers of the system calls that fail with EPERM."""
_CLONE, _CLONE_THREAD, _CLONE3, _X32 = 56, 0x10000, 435, 0x40000000
_AUDIT_ARCH = 0xC000003E
_LOAD, _EQUAL, _AT_LEAST, _ANY_BIT, _RETURN = 0x20, 0x15, 0x35, 0x45, 0x06
_ALLOW, _ERROR, _KILL = 0x7FFF0000, 0x00050000, 0x80000000
_SECCOMP, _FILTER = 22, 2


def refuse_system_calls(libc: ctypes.CDLL) -> int:
    """Install the filter, which needs "no new privileges"; below 0 where the system refuses.

    Threads can still be started: clone with the flag of a thread passes, clone3 is said not to exist, so that the C
    library falls back to clone.
    """
    filters = [
        (_LOAD, 0, 0, 4), (_EQUAL, 1, 0, _AUDIT_ARCH), (_RETURN, 0, 0, _KILL), (_LOAD, 0, 0, 0),
        (_AT_LEAST, 0, 1, _X32), (_RETURN, 0, 0, _KILL),
        (_EQUAL, 0, 1, _CLONE3), (_RETURN, 0, 0, _ERROR | errno.ENOSYS),
    ]  # fmt: skip
    for number in REFUSED.values():
        filters += [(_EQUAL, 0, 1, number), (_RETURN, 0, 0, _ERROR | errno.EPERM)]
    filters += [
        (_EQUAL, 0, 3, _CLONE), (_LOAD, 0, 0, 16), (_ANY_BIT, 1, 0, _CLONE_THREAD),
        (_RETURN, 0, 0, _ERROR | errno.EPERM), (_RETURN, 0, 0, _ALLOW),
    ]  # fmt: skip
    program = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *one) for one in filters))
    described = ctypes.create_string_buffer(struct.pack("HxxxxxxP", len(filters), ctypes.addressof(program)))
    return libc.prctl(_SECCOMP, _FILTER, described, 0, 0)


def is_supported() -> bool:
    """Whether the numbers are of this processor."""
    return os.uname().machine == MACHINE
