"""Text of .glm files: objects, comments, includes and conditions, and what is refused."""

import time

import pytest

from dcgrid_env import FeederError
from dcgrid_env.apps.importers.gridlabd.glm_text import GlmFile


def read(tmp_path, text, **others):
    for name, content in {"m.glm": text, **others}.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(content)
    return GlmFile(tmp_path / "m.glm")


def test_objects_properties_and_comments(tmp_path):
    file = read(
        tmp_path,
        """
        #set profiler=1; // note
        /* object node { name a; }
        */ object node:7 { name "a b"; // object
            phases 'ABCN'; rating.summer.continuous 488.0; url "http://x//y";
            object load { name inner; constant_power_A -1 + 2j; };
        };
        object powerflow.switch { from a; to b; configuration object line_configuration { z11 1; }; }
        """,
    )
    node, load, switch, inline = file.objects
    assert (node.kind, node.number, node.name) == ("node", "7", "a b")
    assert node.properties["url"].text == "http://x//y"
    assert load.parent is node
    assert load.properties["constant_power_A"].text == "-1 + 2j"
    assert switch.kind == "switch"
    assert inline.parent is None
    assert switch.properties["configuration"].text == inline.name
    assert node.where.endswith("m.glm, line 4")


def test_includes_variables_and_conditions(tmp_path):
    file = read(
        tmp_path,
        """#define KV=7200
        #include "sub/lines.glm"
        #ifdef KV
        object node { nominal_voltage ${KV}; }
        #else
        object meter { name not; }
        #endif
        #ifndef KV
        #system rm
        #endif
        #if KV == 7200
        object load { name yes; }
        #endif
        """,
        **{"sub/lines.glm": "object switch { name s; }"},
    )
    assert [item.kind for item in file.objects] == ["switch", "node", "load"]
    assert file.objects[1].properties["nominal_voltage"].text == "7200"


@pytest.mark.parametrize("block", ["clock { timezone X; }", "schedule s { * 1 * * * 0.5; w { * * 1 * * 2; } }",
                                   "module tape;", "class player { double value; }", "#print hello"])  # fmt: skip
def test_what_does_not_change_the_network_is_skipped(block, tmp_path):
    file = read(tmp_path, f"{block}\nobject node {{ name n; }}")
    assert [item.name for item in file.objects] == ["n"]
    assert file.skipped[0][1].endswith("m.glm, line 1")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("\n#system rm -rf /", r"m.glm, line 2: #system is refused: it may start a program"),
        ("#exec a", "#exec is refused"),
        ("#setenv A=B", "#setenv is refused"),
        ("#library x", "#library is refused"),
        ("#include <sys.glm>", 'only #include "FILE" beneath'),
        ('#include "../out.glm"', "#include is refused: .* is not beneath the folder"),
        ('#include "/etc/passwd"', "#include is refused: .* is not beneath the folder"),
        ('#include "none.glm"', "there is no file"),
        ('#include "m.glm"', "include deeper than"),
        ("#error no", "ends with #error"),
        ("#if A >> 2\n#endif", "#if A >> 2 cannot be read"),
        ("#endif", "#endif without #if"),
        ("#ifdef A", "#if without #endif"),
        ("class c { intrinsic sync(TIMESTAMP t) { return 0; }; }", "class c has code, which is refused"),
        ("script on_init rm;", "'script on_init rm' is refused"),
        ('extern "C" { int x; }', "is refused: only objects and modules are read"),
        ("object node { name a; ", "m.glm, line 1: the block or statement does not end"),
        ("object node { name a }", "'name a' before } lacks a semicolon"),
        ("object node:1..5 { name a; }", "several objects in one block"),
        ('object node { name "a; }', "quotation mark without its counterpart"),
        ("object { name a; }", "object without a class"),
        ("}", "lacks a semicolon"),
    ],
)
def test_what_is_refused_is_named_with_its_line(text, said, tmp_path):
    with pytest.raises(FeederError, match=said) as refused:
        read(tmp_path, text)
    assert "\n" not in str(refused.value)


def test_files_are_read_below_the_root(tmp_path):
    read(tmp_path, "object node { name n; }")
    sub = tmp_path / "sub" / "s.glm"
    sub.parent.mkdir()
    sub.write_text('#include "../m.glm"')
    assert len(GlmFile(sub, root=tmp_path).objects) == 1
    with pytest.raises(FeederError, match="not beneath"):
        GlmFile(sub)
    with pytest.raises(FeederError, match="not beneath the root folder"):
        GlmFile(tmp_path / "m.glm", root=tmp_path / "sub")


NESTED = "object node { " * 1500 + "name n; " + "} ;" * 1500


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (NESTED, "m.glm, line 1: blocks nest deeper than 64; write objects one after the other"),
        (NESTED.replace(" object", "\nobject"), "m.glm, line 65: blocks nest deeper"),
        ("schedule s { " + "b { " * 1100 + "* * * * * 1; " + "} " * 1101, "m.glm, line 1: blocks nest deeper than 64"),
        ("#ifdef A\n" * 5000, "m.glm, line 65: blocks nest deeper"),
        (
            "#define a=xxxxxxxxxx\n" + "#define a=${a}${a}${a}${a}\n" * 9,
            "line 5: #define a has 2560 characters; give at",
        ),
        ("#set a=" + "x" * 5000, "m.glm, line 1: #set a has 5000 characters; give at most 1024"),
        (f"#define a={'x' * 1000}\nobject node {{ name {'${a}' * 100}; }}", "line 2: variables make the line longer"),
    ],
)
def test_what_nests_or_grows_without_bound_is_refused(text, said, tmp_path):
    with pytest.raises(FeederError, match=said) as refused:
        read(tmp_path, text)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 300


@pytest.mark.parametrize(
    ("line", "name"),
    [
        ("object node { /* a */ name /* b; */ n; }", "n"),
        ('object node { name "a /* b"; } /* c', "a /* b"),
        ("object node { name 'a//b'; } // c /* d", "a//b"),
        ("/* // */ object node { name n; }", "n"),
        ("/**/object node { name n; }/**/", "n"),
    ],
)
def test_comments_are_left_out(line, name, tmp_path):
    assert [item.name for item in read(tmp_path, line + "\n").objects] == [name]


@pytest.mark.slow
def test_a_line_of_comments_takes_time_in_proportion_to_its_length(tmp_path):
    def seconds(n):
        begin = time.process_time()
        read(tmp_path, "/* a */ " * n + "object node { name n; }")
        return time.process_time() - begin

    seconds(1000)
    assert seconds(400_000) < 30.0 * seconds(40_000)
