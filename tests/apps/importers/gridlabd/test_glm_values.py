"""Numbers with units and in complex notations."""

import pytest

from dcgrid_env.apps.importers.gridlabd.glm_values import number


@pytest.mark.parametrize(
    ("text", "quantity", "value"),
    [
        ("2401.7771 V", "voltage", 2401.7771),
        ("12.47kV", "voltage", 12470.0),
        ("1500 ft", "length", 1500.0),
        ("0.5 mile", "length", 2640.0),
        ("3.0 in", "length", 0.25),
        ("0.927 in", "diameter", 0.927),
        ("0.1 Ohm/km", "impedance per length", 0.1609344),
        ("-1200.8886-2080.000j", "voltage", -1200.8886 - 2080.0j),
        ("- 5 + 2i", "power", -5 + 2j),
        ("0.6 MVAr", "power", 6e5),
        ("300+90j kVA", "power", 300e3 + 90e3j),
        ("3j", "impedance", 3j),
        ("480+120d", "voltage", -240.0 + 415.692193816530j),
        ("2+0r", "voltage", 2.0),
        ("1500 kVA", "rating", 1500.0),
        ("1.5 MVA", "rating", 1500.0),
        (".5e-1", "ratio", 0.05),
    ],
)
def test_values(text, quantity, value):
    assert number(text, quantity) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "quantity", "said"),
    [
        ("weekday*2", "power", "must be a number, such as"),
        ("", "power", "must be a number"),
        ("5 ft", "voltage", "must be in V, kV, MV"),
        ("1e999", "voltage", "must be a finite number"),
        ("nan", "voltage", "must be a number"),
    ],
)
def test_what_is_no_value(text, quantity, said):
    with pytest.raises(ValueError, match=said):
        number(text, quantity)
