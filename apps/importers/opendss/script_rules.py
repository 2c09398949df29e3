"""What an OpenDSS script that nobody vouches for may say: the model's definition, and nothing that acts on the machine.

All that is not known to be harmless is refused. Names are resolved as OpenDSS does, without regard to case, and an
abbreviation only where one name begins with it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from dcgrid_env.apps.importers.opendss.dss_words import Word

DEFINING = ("new", "edit", "more", "m", "~", "batchedit")
"""Commands that set properties of elements."""
FILES = ("redirect", "compile", "buscoords", "latlongcoords")
"""Commands that name one file to read."""
OPTIONS = ("set", "solve")
"""Commands that set options."""
ELEMENT_COMMANDS = (
    "clear", "clearall", "select", "enable", "disable", "open", "close", "calcvoltagebases", "setkvbase",
    "makebuslist", "reprocessbuses", "allocateloads", "setbusxy",
)  # fmt: skip
"""Commands that name elements and figures alone."""
COMMANDS = (*DEFINING, *FILES, *OPTIONS, *ELEMENT_COMMANDS)
SKIPPED = (
    "show", "plot", "export", "dump", "summary", "visualize", "addbusmarker", "clearbusmarkers", "currents", "voltages",
    "powers", "losses", "phaselosses", "cktlosses", "seqvoltages", "seqcurrents", "seqpowers", "nodelist", "totals",
    "capacity", "sample", "resetmeters", "resetmonitors", "closedi", "about", "help", "fileedit", "save", "panel",
)  # fmt: skip
"""Commands that show, draw or write results, and are left out: the model does not depend on them."""
SKIPPED_OPTIONS = ("datapath", "showexport", "editor", "recorder", "datacsvseparator", "demandinterval", "casename")
"""Options of where and how results are written, which are left out too."""
_PLAIN_WORDS = ("object", "bus", "x", "y", "kvll", "kvln", "element")
_BY_PLACE = (("object", "element"), ("term", "terminal"), ("cond", "conductor", "phase"))
"""Names of the words of Open, Close and Select: OpenDSS reads their values by position, whatever the names are."""
HARMLESS_OPTIONS = (
    "mode", "tolerance", "maxiterations", "miniterations", "maxcontroliter", "controlmode", "loadmodel", "loadmult",
    "frequency", "basefrequency", "defaultbasefrequency", "normvminpu", "normvmaxpu", "emergvminpu", "emergvmaxpu",
    "%normal", "%mean", "%stddev", "%growth", "voltagebases", "algorithm", "trapezoidal", "genmult", "harmonics",
    "allowduplicates", "earthmodel", "neglectloady", "longlinecorrection", "allocationfactors", "cfactors",
    "numallociterations", "cktmodel", "circuit", "defaultdaily", "defaultyearly", "loadshapeclass", "random", "hour",
    "sec", "h", "stepsize", "time", "number", "zonelock", "ueweight", "lossweight", "bus", "class", "type", "element",
    "object", "terminal", "nodewidth", "markercode", "markswitches", "switchmarkercode", "daisysize",
    "marktransformers", "transmarkercode", "transmarkersize", "markcapacitors", "capmarkercode", "capmarkersize",
    "markregulators", "regmarkercode", "regmarkersize", "linetypes", "eventlogdefault", "processtime", "totaltime",
)  # fmt: skip
"""Options that change figures of the solution or of pictures that are not drawn; not the year, which grows loads."""
_SNAPSHOT = ("snap", "snapshot", "direct")
BY_POSITION = (
    "circuit", "vsource", "linecode", "line", "load", "transformer", "xfmrcode", "capacitor", "reactor", "wiredata",
    "cndata", "tsdata", "linespacing", "linegeometry", "tcc_curve",
)  # fmt: skip
"""Classes of elements whose properties name no file, program or action: all may be given by position."""
HARMLESS_POSITIONS = 2
"""Number of properties of other classes that may be given by position, such as the monitored element and terminal."""
READS = ("csvfile", "sngfile", "dblfile", "pqcsvfile")
"""Properties that name a file of figures."""
_ACTIONS = ("open", "close", "normalize", "clear", "trip", "lock", "unlock", "o", "c")
_LOADS = ("usermodel", "userdata", "shaftmodel", "shaftdata", "dynadll", "dynadata")
_DANGEROUS = (*READS, *_LOADS, "action", "debugtrace")
_ONE_LETTER = (("generator", "d"), ("indmach012", "d"), ("gicline", "c"))  # whole names, no abbreviations
_SUSPECT = re.compile(r"file|dll|usermodel|userdata|shaft|debug|trace", re.IGNORECASE)
FILE_WITHIN = re.compile(
    r"""^\s*(?P<kind>file|sngfile|dblfile)\s*=\s*(?P<path>"[^"]+"|'[^']+'|[^\s,"']+)"""
    r"""(?P<rest>(\s*,?\s*(col|column|header)\s*=\s*\w+)*)\s*$""",
    re.IGNORECASE,
)
"""A value in brackets that refers to the figures of a file."""
COLUMNS_WITHIN = re.compile(r"(col|column|header)\s*=\s*(\w+)", re.IGNORECASE)
"""One of its settings."""
_NAMED = re.compile(r"(file|sngfile|dblfile)\s*=", re.IGNORECASE)
"""Text by which OpenDSS reads figures from a file."""
_BUSES = ("bus", "bus1", "bus2", "buses")
"""Properties that are names of buses, which may contain an equals sign."""


def resolved(word: str, ours: Sequence[str], theirs: Sequence[str]) -> str:
    """Return the name that a word abbreviates, in lower case.

    Raises ValueError unless the name is in ``ours`` and the word matches no other name in ``theirs``.
    """
    word = word.lower()
    known = {name.lower() for name in theirs}
    matching = [word] if word in known else sorted(name for name in known if name.startswith(word))
    if not matching:
        raise ValueError(f"{word!r} is not known to OpenDSS")
    if len(matching) > 1:
        raise ValueError(f"{word!r} may be {', '.join(matching[:4])}; write it out")
    if matching[0] not in ours:
        raise ValueError(f"{matching[0]!r} is not part of a model's definition")
    return matching[0]


def check_option(word: Word, theirs: Sequence[str]) -> Word:
    """An option of Set or Solve with its name written out; ValueError for one that is not harmless."""
    if not word.name:
        raise ValueError(f"the option {word.text!r} has no name; write name=value")
    name = resolved(word.name, HARMLESS_OPTIONS, theirs)
    if name == "mode" and word.text.lower() not in _SNAPSHOT:
        raise ValueError(f"mode={word.text} solves more than the present; leave it out, or give mode=snapshot")
    if "=" in word.text:
        raise ValueError(f"{str(word)!r} may name a file; write the figures")
    return word._replace(name=name)


def check_plain(command: str, words: Sequence[Word]) -> None:
    """Raise ValueError if a word of a plain command is not an element, a figure or a known name."""
    by_place = command in ("open", "close", "select")
    if by_place and len(words) > len(_BY_PLACE):
        raise ValueError(
            f"{str(words[len(_BY_PLACE)])!r} is one word too many; write {command} class.name terminal phase"
        )
    for place, word in enumerate(words):
        names = _BY_PLACE[place] if by_place else _PLAIN_WORDS
        if word.name and word.name.lower() not in names:
            where = f"as word {place + 1}" if by_place else "here"
            raise ValueError(f"{word.name!r} is not known {where}; choose {', '.join(names)}")
        if _NAMED.search(word.text):
            raise ValueError(f"{str(word)!r} may name a file")


def check_property(kind: str, word: Word, is_first: bool) -> str:
    """Return how a property names a file: ``all`` of its value, ``within`` its brackets, or not (``""``).

    ``is_first`` is true if the property is among the first ``HARMLESS_POSITIONS`` and follows no named one, from which
    OpenDSS would continue counting.
    Raises ValueError for a property that acts, loads a program or writes, or that may be one of these.
    """
    name = word.name.lower()
    if not name:
        if kind not in BY_POSITION and not is_first:
            raise ValueError(f"{str(word)!r} is given by position; write property=value for a {kind}")
    elif name in READS:
        return "all"
    elif name == "action":
        if kind == "fuse":
            raise ValueError("the property action of a fuse damages OpenDSS's memory; write state=(open open open)")
        if word.text.lower() not in _ACTIONS:
            raise ValueError(f"{str(word)!r} acts; the actions {', '.join(_ACTIONS)} are harmless")
    elif (kind, name) not in _ONE_LETTER and (
        (matching := [other for other in _DANGEROUS if other.startswith(name)]) or _SUSPECT.search(name)
    ):
        why = f"may be {matching[0]}" if matching else "may name a file or a program"
        raise ValueError(f"the property {word.name!r} {why}; leave it out")
    if "=" in word.text and (name not in _BUSES or _NAMED.search(word.text)):
        if word.quote not in ("(", "[") or not FILE_WITHIN.match(word.text):
            raise ValueError(f"{str(word)!r} may name a file; give the figures, or (file=NAME)")
        return "within"
    return ""
