"""Groups of devices in words: reading, and refusals with a remedy."""

import pytest

from dcgrid_env import ScenarioError
from dcgrid_env.scenario.group_notation import DATA_CENTRES, INVERTERS, Part, read_group


@pytest.mark.parametrize(
    ("kind", "text", "parts"),
    [
        (DATA_CENTRES, "3 x 1 MW", [Part(3, 1000.0, "drawn")]),
        (DATA_CENTRES, " 3x1.5mw AT THE ENDS ", [Part(3, 1500.0, "at ends")]),
        (DATA_CENTRES, "3 × 250 kW at 18, 33,25", [Part(3, 250.0, ("18", "33", "25"))]),
        (DATA_CENTRES, "1e3 kW at Bus A+1,Bus B", [Part(2, 1000.0, ("Bus A+1", "Bus B"))]),
        (DATA_CENTRES, "2 x 500 kW at ends+2 MW at 18", [Part(2, 500.0, "at ends"), Part(1, 2000.0, ("18",))]),
        (DATA_CENTRES, "none", []),
        (INVERTERS, "5 x 200 kvar", [Part(5, 200.0, "spread")]),
        (INVERTERS, "2 * .5 Mvar at ends + 1 x 1 MVA spread", [Part(2, 500.0, "at ends"), Part(1, 1000.0, "spread")]),
        (INVERTERS, "200 kVA", [Part(1, 200.0, "spread")]),
    ],
)
def test_words_are_read(kind, text, parts):
    assert list(read_group(kind, text)) == parts


@pytest.mark.parametrize(
    ("kind", "text", "message"),
    [
        (DATA_CENTRES, "", "datacenters: '' is no group; write COUNT x SIZE UNIT and a place, such as '3 x 1 MW at"),
        (DATA_CENTRES, "three of 1 MW", "is no group; write COUNT x SIZE UNIT"),
        (DATA_CENTRES, "-1 MW", "is no group"),
        (DATA_CENTRES, "3 x 1 kvar", "datacenters: '3 x 1 kvar' is in 'kvar'; give kW or MW"),
        (INVERTERS, "3 x 1 kW", "inverters: '3 x 1 kW' is in 'kW'; give kvar, Mvar, kVA or MVA"),
        (DATA_CENTRES, "0 x 1 MW", "has the count 0; give at least 1, or none"),
        (DATA_CENTRES, "2 x 0 MW", "has the size 0; give more than 0"),
        (DATA_CENTRES, "1e999 MW", "has the size 1e999; give more than 0"),
        (DATA_CENTRES, "3 x 1 MW at 18,33", "names 2 buses for 3 devices; name one for each"),
        (DATA_CENTRES, "1 MW at 18,,33", "has the place 'at 18,,33'; write drawn, at ends or at BUS,BUS,.."),
        (DATA_CENTRES, "1 MW near 18", "has the place 'near 18'; write drawn, at ends or at"),
        (DATA_CENTRES, "1 MW spread", "is to be spread, which datacenters cannot be; write drawn"),
        (INVERTERS, "1 kvar drawn", "is to be drawn, which inverters cannot be; write spread"),
        (
            DATA_CENTRES,
            "1 MW + 2 x 1 MW at ends",
            "has drawn devices and others at fixed places; give",
        ),
        (DATA_CENTRES, "9999 x 1 MW + 2 x 1 MW", "asks for 10001 devices; give at most 10000"),
    ],
)
def test_words_that_cannot_be_are_refused_with_a_remedy(kind, text, message):
    with pytest.raises(ScenarioError) as refused:
        read_group(kind, text)
    assert message in str(refused.value)
    assert "\n" not in str(refused.value)
