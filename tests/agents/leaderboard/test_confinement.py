"""Code of a submitter in a confined process: attacks fail, numerical code runs."""

import errno
import os
import subprocess
import sys
import textwrap
import time
from contextlib import closing
from pathlib import Path

import pytest

from dcgrid_env.agents.leaderboard import remote
from dcgrid_env.agents.leaderboard.running import TUNED, scenario_of
from helpers.submitted_code import acted, confines, require_refused

pytestmark = confines


@pytest.fixture(scope="module")
def victim():
    """A process of the same user, such as the verifier."""
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"]) as process:
        yield process
        process.kill()


SIGNAL_OF_INPUT = """
readable, writable = os.pipe()
{calls}
os.write(writable, b"x")
"""
MACHINE_CODE = """
page = mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC)
page.write(bytes([0xB8, 20, 0, 0, 0, 0xCD, 0x80, 0xC3]))  # mov eax, getpid; int 0x80; ret
ctypes.CFUNCTYPE(ctypes.c_int)(ctypes.addressof(ctypes.c_char.from_buffer(page)))()
"""


ON_PROCESSES = (
    "os.kill({pid}, 9)",
    "called(libc.tgkill({pid}, {pid}, 9))",
    "called(libc.syscall(129, {pid}, 9, bytes(128)))",  # rt_sigqueueinfo
    SIGNAL_OF_INPUT.format(
        calls="fcntl.fcntl(readable, fcntl.F_SETOWN, {pid})\nfcntl.fcntl(readable, fcntl.F_SETSIG, 9)\n"
        "fcntl.fcntl(readable, fcntl.F_SETFL, os.O_ASYNC)"
    ),
    "fcntl.fcntl(int(sys.argv[1]), fcntl.F_SETFL, os.O_ASYNC)",
    "fcntl.fcntl(int(sys.argv[1]), 15, (1).to_bytes(4, 'little') + ({pid}).to_bytes(4, 'little'))",  # F_SETOWN_EX
    "fcntl.ioctl(int(sys.argv[1]), 0x8901, ({pid}).to_bytes(4, 'little'))",  # FIOSETOWN
    "fcntl.ioctl(int(sys.argv[1]), 0x8902, ({pid}).to_bytes(4, 'little'))",  # SIOCSPGRP
    "fcntl.ioctl(int(sys.argv[1]), 0x5452, (1).to_bytes(4, 'little'))",  # FIOASYNC
    "resource.prlimit({pid}, resource.RLIMIT_CPU, (0, 0))",
    "resource.prlimit({pid}, resource.RLIMIT_CPU)",
    "os.setpriority(os.PRIO_PROCESS, {pid}, 19)",
    "os.sched_setaffinity({pid}, {{0}})",
    "os.sched_setscheduler({pid}, os.SCHED_IDLE, os.sched_param(0))",
    "called(libc.syscall(251, 1, {pid}, 3 << 13))",  # ioprio_set
    "called(libc.ptrace(16, {pid}, 0, 0))",
    "called(libc.process_vm_readv({pid}, 0, 0, 0, 0, 0))",
    "called(libc.syscall(312, {pid}, {pid}, 0, 0, 0))",  # kcmp
    "called(libc.syscall(256, {pid}, 8, bytes(8), bytes(8)))",  # migrate_pages
    "called(libc.prctl(1, 9))",  # PR_SET_PDEATHSIG
    "os.fork()",
    "subprocess.run(['/bin/true'], check=True)",
    "called(libc.syscall(56, 17, 0, 0, 0, 0))",  # clone of a process
    "called(libc.unshare(0x10000000))",
)


@pytest.mark.slow
def test_confined_code_cannot_change_or_signal_another_process(victim):
    require_refused([attack.format(pid=victim.pid) for attack in ON_PROCESSES], errno.EPERM)
    time.sleep(0.1)
    assert victim.poll() is None


NEWER = (
    "437, -100, b'controller.py', bytes(24), 24",  # openat2
    "435, bytes(88), 88",  # clone3
    "434, {pid}, 0",  # pidfd_open
    "424, 0, 9, 0, 0",  # pidfd_send_signal
    "425, 8, bytes(120)",  # io_uring_setup
    "452, -100, b'controller.py', 0o777, 0",  # fchmodat2
    "463, -100, b'controller.py', 0, b'user.x', bytes(16), 16",  # setxattrat
)


@pytest.mark.slow
def test_newer_system_calls_do_not_exist_for_confined_code(victim):
    """A C library then uses an older call, which the filter covers."""
    attacks = [f"called(libc.syscall({call.format(pid=victim.pid)}))" for call in NEWER]
    require_refused(attacks, errno.ENOSYS)


@pytest.mark.parametrize("body", [f"libc.syscall({0x40000000 + 39})", MACHINE_CODE])
@pytest.mark.slow
def test_system_calls_of_another_interface_end_the_process(body):
    with pytest.raises(remote.ProcessError, match=r"its process ended \(signal (31|11)\)"):
        acted(body, confined=True)


METADATA = (
    "os.chmod('{path}', 0o777)",
    "os.chown('{path}', os.getuid(), os.getgid())",
    "os.lchown('{path}', os.getuid(), os.getgid())",
    "os.utime('{path}', (1, 1))",
    "os.utime('{path}', (1, 1), follow_symlinks=False)",
    "os.setxattr('{path}', 'user.x', b'1')",
    "os.getxattr('{path}', 'user.x')",
    "os.listxattr('{path}')",
    "os.removexattr('{path}', 'user.x')",
    "called(libc.chmod(b'{path}', 0o777))",
    "called(libc.utimes(b'{path}', bytes(32)))",
    "called(libc.syscall(132, b'{path}', bytes(16)))",  # utime
    "called(libc.syscall(261, -100, b'{path}', bytes(32)))",  # futimesat
)


@pytest.mark.slow
def test_confined_code_cannot_change_metadata_of_a_file(tmp_path):
    path = tmp_path / "report.json"
    path.write_text("{}")
    before = path.stat()
    require_refused([attack.format(path=path) for attack in METADATA], errno.EPERM)
    assert path.stat()[:9] == before[:9]


CHANNELS = (
    "fcntl.lockf(file, fcntl.LOCK_SH)",  # F_SETLK
    "fcntl.fcntl(file, fcntl.F_GETLK, bytes(32))",
    "fcntl.fcntl(file, fcntl.F_OFD_SETLK, bytes(32))",
    "fcntl.fcntl(file, fcntl.F_OFD_GETLK, bytes(32))",
    "fcntl.flock(file, fcntl.LOCK_SH)",
    "fcntl.fcntl(file, fcntl.F_SETLEASE, fcntl.F_RDLCK)",
    "fcntl.fcntl(file, fcntl.F_NOTIFY, fcntl.DN_MODIFY)",
    "os.fchmod(file, 0o777)",
    "os.fchown(file, os.getuid(), os.getgid())",
    "os.utime(file, (1, 1))",
    "os.setxattr(file, 'user.x', b'1')",
    "os.getxattr(file, 'user.x')",
    "called(libc.inotify_init1(0))",
    "called(libc.fanotify_init(0, 0))",
    "called(libc.shmget(7, 4096, 0o1666))",
    "called(libc.semget(7, 1, 0o1666))",
    "called(libc.msgget(7, 0o1666))",
    "called(libc.syscall(240, b'x', 0o102, 0o666, 0))",  # mq_open
    "called(libc.syscall(248, b'user', b'x', b'1', 1, -3))",  # add_key
    "called(libc.syscall(250, 0, -3, 0))",  # keyctl
    "called(libc.syscall(99, bytes(128)))",  # sysinfo
    "os.statvfs('/usr')",
    "socket.socket(socket.AF_UNIX)",
    "socket.socket(socket.AF_INET, socket.SOCK_DGRAM)",
    "socket.socketpair()",
    "called(libc.syscall(46, int(sys.argv[1]), bytes(56), 0))",  # sendmsg
    "os.mkfifo('{path}3')",
    "open('/dev/shm/dcgrid', 'w')",
    "open('{path}2', 'w')",
    "os.listdir(os.path.dirname('{path}'))",
    "os.listdir('/proc')",
    "open('/proc/self/status')",
    "open('{path}', 'a')",
    "called(libc.open(b'{path}', os.O_TRUNC))",
)


@pytest.mark.slow
def test_two_confined_processes_share_no_lock_metadata_message_or_folder(tmp_path):
    path = tmp_path / "shared"
    path.write_text("{}")
    opening = "file = os.open('controller.py', os.O_RDWR)\n"
    attacks = [opening + attack.format(path=path) for attack in CHANNELS]
    require_refused(attacks, errno.EPERM, errno.EACCES)


VERIFIER = (
    "open('{here}/verifier.key').read()",
    "open('{here}/verifier.key', 'w')",
    "os.listdir('{here}')",
    "open('{here}/verified.json', 'w')",
    "open('/proc/{pid}/mem', 'rb')",
    "open('/proc/{pid}/environ', 'rb').read()",
    "os.readlink('/proc/{pid}/cwd')",
    "open('/proc/self/maps').read()",
)


@pytest.mark.slow
def test_confined_code_reads_and_writes_nothing_of_the_verifier(tmp_path):
    (tmp_path / "verifier.key").write_text("key")
    require_refused([attack.format(here=tmp_path, pid=os.getpid()) for attack in VERIFIER], errno.EACCES)


@pytest.mark.slow
def test_short_of_memory_the_kernel_ends_confined_code_before_the_verifier():
    with closing(remote.ControllerProcess(of_submitter=True)) as process:
        code = b"class Own:\n    def reset(self, env_info): ...\n    def act(self, observations): ..."
        process.load("controller.py:Own", scenario_of("toy6"), TUNED, code, confined=True)
        assert Path(f"/proc/{process._process.pid}/oom_score_adj").read_text() == "1000\n"


@pytest.mark.slow
def test_the_memory_of_confined_code_is_limited():
    with pytest.raises(remote.ProcessError, match="MemoryError"):
        acted("np.ones(2**31)", confined=True)


NUMERICAL = {
    "own folder": """
        import shutil, tempfile
        os.makedirs("a/b"); np.savez("a/b/x.npz", x=np.ones(3)); np.load("a/b/x.npz")["x"]
        os.replace("a/b/x.npz", "y.npz"); shutil.copyfile("y.npz", "z.npz"); os.remove("z.npz"); shutil.rmtree("a")
        with tempfile.TemporaryDirectory() as folder, open(f"{folder}/log", "w+") as file:
            file.write("line"); file.flush(); os.fsync(file.fileno()); file.truncate(1); file.seek(0)
            assert file.read() == "l"
        np.lib.format.open_memmap("map.npy", "w+", shape=(4,))[:] = 1.0
    """,
    "threads": """
        from concurrent.futures import ThreadPoolExecutor
        with ThreadPoolExecutor(4) as pool:
            assert sum(pool.map(abs, range(100))) == 4950
    """,
    "scipy": """
        import scipy.linalg, scipy.optimize, scipy.sparse, scipy.sparse.linalg
        scipy.linalg.solve(np.eye(300), np.ones(300))
        scipy.sparse.linalg.spsolve(scipy.sparse.eye(50, format="csc"), np.ones(50))
        assert scipy.optimize.linprog([1.0, 1.0], bounds=[(1, 2)] * 2).fun == 2.0
        scipy.optimize.minimize(lambda x: (x**2).sum(), np.ones(3))
    """,
    "torch": """
        import torch
        net = torch.nn.Sequential(torch.nn.Linear(23, 64), torch.nn.Tanh(), torch.nn.Linear(64, 4))
        with torch.no_grad():
            assert net(torch.tensor(observations)).shape == (2, 4)
        torch.save(net.state_dict(), "net.pt"); net.load_state_dict(torch.load("net.pt", weights_only=True))
        net(torch.ones(2, 23)).sum().backward()
    """,
    "Stable-Baselines3": """
        import gymnasium as gym
        from stable_baselines3.common.policies import ActorCriticPolicy
        from stable_baselines3.sac.policies import SACPolicy
        boxes = gym.spaces.Box(-1, 1, (23,)), gym.spaces.Box(-1, 1, (4,))
        for kind in (ActorCriticPolicy, SACPolicy):
            policy = kind(*boxes, lambda _: 1e-3)
            policy.save("policy.pt")
            assert kind.load("policy.pt").predict(np.ones((2, 23)), deterministic=True)[0].shape == (2, 4)
    """,
    "numba": """
        import numba
        @numba.njit(cache=True)
        def doubled(x):
            return 2.0 * x
        assert doubled(3.0) == 6.0
        assert any(name.endswith(".nbi") for _, _, names in os.walk(".") for name in names), "no cache"
        @numba.njit(parallel=True)
        def summed(x):
            total = 0.0
            for i in numba.prange(len(x)):
                total += x[i]
            return total
        assert summed(np.ones(100)) == 100.0
    """,
    "numba without a cache folder": """
        os.environ.pop("NUMBA_CACHE_DIR"); os.environ["HOME"] = "/nowhere"
        import numba
        numba.config.reload_config()
        assert not numba.config.CACHE_DIR
        @numba.njit
        def doubled(x):
            return 2.0 * x
        assert doubled(3.0) == 6.0
    """,
    "package": """
        from dcgrid_env.baselines import find_controller
        from dcgrid_env.baselines.rollout import rollout
        from dcgrid_env.agents.leaderboard.running import scenario_of
        scenario = scenario_of("toy6")
        rollout(scenario, find_controller("mpc", scenario), [5], name="mpc")
    """,
}


@pytest.mark.slow
@pytest.mark.parametrize("name", NUMERICAL)
def test_numerical_code_runs_confined(name):
    assert acted(textwrap.dedent(NUMERICAL[name]).strip(), confined=True).shape == (2, 4)
