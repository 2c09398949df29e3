"""OpenDSS scripts with something changed at random, and what becomes of many of them.

OpenDSS may end the process that reads a damaged script, so each is read in a fork of a process that has all modules.
"""

import json
import os
import random
import re
import signal
import subprocess
import sys
from pathlib import Path

from dcgrid_env import FeederError, ThreePhaseFeeder
from dcgrid_env.apps.importers.opendss.dss_source import ALLOWABLE
from dcgrid_env.apps.importers.opendss.reading import read_circuit
from dcgrid_env.powerflow import solve_unbalanced
from helpers.places import ROOT

SECONDS = 60
"""Longest that a script may take."""
LONGEST = 2000
"""Bytes of an outcome that are kept."""
CLOSE_PU = 1e-6
"""Largest voltage difference from OpenDSS, as a share of the largest voltage if that is beyond 1 p.u."""
RADIAL = """Clear
Set DefaultBaseFrequency=60
New Circuit.town basekv=12.47 pu=1.02 bus1=src angle=10 MVAsc3=200 MVAsc1=150
New Linecode.c3 nphases=3 units=mi rmatrix=(0.34 | 0.15 0.33 | 0.16 0.15 0.35) xmatrix=(1.0 | 0.5 1.1 | 0.4 0.38 1.05)
~ cmatrix=(16 | -5 15 | -3 -2 14)
New Line.l1 bus1=src.2.1.3 bus2=m.2.1.3 linecode=c3 length=2000 units=ft normamps=300
New Line.l2 bus1=m bus2=n linecode=c3 length=0.5 units=km
New Line.l3 bus1=n.1 bus2=p.1 phases=1 r1=0.3 x1=0.4 r0=0.6 x0=1.2 c1=3 c0=2 length=1 units=km
New Line.s bus1=n bus2=far phases=3 switch=yes
New SwtControl.s switchedobj=line.s switchedterm=1 state=closed
New Fuse.l3 monitoredobj=line.l3 ratedcurrent=100
New Recloser.l2 monitoredobj=line.l2 switchedobj=line.l2 phasetrip=1e4 groundtrip=1e4
New Transformer.t phases=3 buses=(far low) conns=(delta wye) kvs=(12.47 0.48) kvas=(500 500) xhl=4 %r=1
New Transformer.reg1 phases=1 buses=(n.1 q.1) kvs=(7.2 7.2) kvas=(900 900) xhl=0.01 %loadloss=0.01 wdg=2 tap=1.0625
New Transformer.reg2 phases=1 buses=(n.2 q.2) kvs=(7.2 7.2) kvas=(900 900) xhl=0.01 %loadloss=0.01 wdg=2 tap=0.9625
New Transformer.reg3 phases=1 buses=(n.3 q.3) kvs=(7.2 7.2) kvas=(900 900) xhl=0.01 %loadloss=0.01 wdg=2 tap=1.05
New RegControl.c1 transformer=reg1 winding=2 vreg=122 band=2 ptratio=60 ctprim=100 r=1 x=2
New RegControl.c2 transformer=reg2 winding=2 vreg=122 band=2 ptratio=60
New RegControl.c3 transformer=reg3 winding=2 vreg=122 band=2 ptratio=60
New Load.d bus1=q conn=delta kv=12.47 kw=300 kvar=100
New Load.l bus1=low kv=0.48 kw=90 pf=0.9 model=2
New Load.p bus1=p.1 phases=1 kv=7.2 kw=40 kvar=10 model=8 zipv=[0.3 0.3 0.4 0.2 0.3 0.5 0]
New Load.e bus1=low.1 phases=1 kv=0.277 kw=9 model=4 cvrwatts=0.8 cvrvars=2
New Capacitor.c bus1=q phases=3 kv=12.47 kvar=[100 50] numsteps=2 states=[1 0]
New Monitor.m element=line.l1 terminal=1
Set VoltageBases=[12.47 0.48]
CalcVoltageBases
Set maxcontroliter=100
Solve
"""
MESHED = """Clear
New Circuit.loop basekv=4.16 pu=1.01 bus1=a R1=0.01 X1=0.1 R0=0.02 X0=0.2
New Wiredata.w gmr=0.0255 diam=0.741 rac=0.306 normamps=530 runits=mi gmrunits=ft radunits=in
New Linegeometry.g nconds=3 nphases=3 cond=1 wire=w x=0 h=30 units=ft cond=2 wire=w x=3 h=30
~ cond=3 wire=w x=6 h=30
New Line.ab bus1=a bus2=b geometry=g length=1 units=kft
New Line.bc bus1=b bus2=c geometry=g length=1 units=kft
New Line.ca bus1=c bus2=a r1=0.1 x1=0.2 r0=0.3 x0=0.6 c1=0 c0=0
New Line.twin like=ca bus1=b bus2=c
New Reactor.x bus1=c bus2=d phases=3 r=0.01 x=0.3
New Reactor.shunt bus1=d phases=3 kv=4.16 kvar=30
New Fault.f bus1=b.1 r=900
New Transformer.split phases=1 windings=3 buses=(d.1 e.1.0 e.0.2) kvs=(2.4 0.12 0.12) kvas=(25 25 25) xhl=2
New Transformer.o phases=3 buses=(d g.1.2.3.4) conns=(delta wye) kvs=(4.16 0.208) kvas=(75 75) %noloadloss=0.5 %imag=1
New Reactor.ground bus1=g.4 phases=1 r=0.1 x=0
New Load.e1 bus1=e.1 phases=1 kv=0.12 kw=3 kvar=1
New Load.e2 bus1=e.1.2 phases=1 kv=0.24 kw=4 kvar=1 model=5
New Load.g bus1=g.1.2.3.4 phases=3 kv=0.208 kw=30 kvar=9
New Load.c bus1=c.2 phases=1 kv=2.4 kw=50 pf=0.95 model=3
New Capacitor.s bus1=c.1 bus2=h.1 phases=1 kv=2.4 kvar=900
New Load.h bus1=h.1 phases=1 kv=2.4 kw=5
New ISource.i bus1=b phases=3 amps=2
Open Line.twin terminal=1 phase=1
New Relay.r monitoredobj=line.bc
New EnergyMeter.m element=line.ab
Set VoltageBases=[4.16 0.208]
CalcVoltageBases
"""
SCRIPTS = (RADIAL, MESHED)
ODD = [
    "nan",
    "-1",
    "0",
    "1e300",
    "-1e300",
    "1e-300",
    "inf",
    "",
    "1e400",
    "0.5",
    "2",
    "7",
    "1.5",
    "99",
    "abc",
    "yes",
    "(1 2)",
]
"""What a number may become."""
_WORD, _NUMBER = re.compile(r"[^\s=()\[\],|]+"), re.compile(r"(?<![\w.])-?\d+(\.\d+)?(?![\w.])")
_BUSES = re.compile(r"(?<=bus1=|bus2=)[a-z]+")


def mutated(seed: int) -> str:
    """One of the scripts with one to three changes; the same for a seed."""
    rng = random.Random(seed)
    script = rng.choice(SCRIPTS)
    for _ in range(rng.choice((1, 1, 2, 3))):
        script = _CHANGES[rng.randrange(len(_CHANGES))](script, rng)
    return script


def _other_byte(script, rng):
    at = rng.randrange(len(script) + 1)
    new = rng.choice(["", chr(rng.randrange(256)), rng.choice("0123456789.,;:-+=|()[]{}\"'!/~@#%\n\t \0")])
    return script[:at] + new + script[at + rng.randrange(3) :]


def _other_number(script, rng):
    found = rng.choice(list(_NUMBER.finditer(script)))
    return script[: found.start()] + rng.choice(ODD) + script[found.end() :]


def _other_word(script, rng):
    words = list(_WORD.finditer(script))
    found, other = rng.choice(words), rng.choice(words)
    return script[: found.start()] + other.group() + script[found.end() :]


def _no_word(script, rng):
    found = rng.choice(list(_WORD.finditer(script)))
    return script[: found.start()] + script[found.end() :]


def _other_bus(script, rng):
    buses = list(_BUSES.finditer(script))
    found, other = rng.choice(buses), rng.choice(buses)
    return script[: found.start()] + other.group() + script[found.end() :]


def _of_lines(change):
    def changed(script, rng):
        lines = script.split("\n")
        change(lines, rng.randrange(len(lines)), rng.randrange(len(lines)))
        return "\n".join(lines)

    return changed


def _swap(lines, one, other):
    lines[one], lines[other] = lines[other], lines[one]


_CHANGES = (
    _other_byte, _other_number, _other_number, _other_word, _no_word, _other_bus,
    _of_lines(lambda lines, one, other: lines.pop(one)),
    _of_lines(lambda lines, one, other: lines.insert(other, lines[one])),
    _of_lines(_swap),
)  # fmt: skip


def outcome(path: Path) -> str:
    """What becomes of a script: imported, unsolved, or refused with a line; anything else is a defect."""
    try:
        found = read_circuit(path, allow=ALLOWABLE)
        feeder = ThreePhaseFeeder.from_network(found.network)
        if not found.v_pu_without:
            return "unsolved: no solution from OpenDSS"
        solution = solve_unbalanced(feeder, feeder.p_load_kw, feeder.q_load_kvar)
    except FeederError as error:
        said = str(error)
        one_line = said.strip() and len(said.splitlines()) == 1
        return f"refused: {said}" if one_line else f"defect: not one line: {said!r}"
    except Exception as error:
        return f"defect: {type(error).__name__}: {error}"
    if not solution.converged:
        return "unsolved: no solution from dcgrid"
    v = dict(zip(feeder.node_ids, solution.v_re_pu + 1j * solution.v_im_pu, strict=True))
    apart = {node: float(abs(v[node] - there)) for node, there in found.v_pu_without.items()}
    most = max(apart, key=lambda node: apart[node])
    scale = max(1.0, *map(abs, found.v_pu_without.values()))
    return "imported" if apart[most] <= CLOSE_PU * scale else f"defect: {apart[most]:.2e} p.u. at {most}"


def outcomes(seeds: range, folder: Path) -> dict[int, str]:
    """What becomes of the scripts of these seeds; ``ended`` or ``late`` where OpenDSS ended its process or hung."""
    done = subprocess.run(
        [sys.executable, "-c", "from helpers.opendss_fuzzing import serve; serve()", str(folder), *map(str, seeds)],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=True,
        env=os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "tests/support")])},
    )  # fmt: skip
    return dict(zip(seeds, map(json.loads, done.stdout.splitlines()), strict=True))


def serve() -> None:
    """Write the outcome of each seed among the arguments as a line of JSON; each in a separate process."""
    folder, *seeds = sys.argv[1:]
    path = Path(folder) / "Master.dss"
    for script in SCRIPTS:  # compiles the power flows before the processes are forked
        path.write_text(script)
        outcome(path)
    for seed in seeds:
        path.write_text(mutated(int(seed)), encoding="utf-8", newline="")
        print(json.dumps(_in_fork(path)), flush=True)


def _in_fork(path: Path) -> str:
    end, begin = os.pipe()
    child = os.fork()
    if not child:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # OpenDSS may print
        signal.alarm(SECONDS)
        os.write(begin, outcome(path)[:LONGEST].encode())
        os._exit(0)
    os.close(begin)
    with os.fdopen(end, encoding="utf-8", errors="replace") as said:
        text = said.read()
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if not code:
        return text
    return "late" if code == -signal.SIGALRM else f"ended: {signal.Signals(-code).name if code < 0 else code}"
