"""Matrices of lines against those that IEEE publishes for its 13-node feeder, Ohm/mile and microsiemens/mile."""

import numpy as np
import pytest

from dcgrid_env import FeederError
from dcgrid_env.apps.importers.gridlabd.glm_model import Model
from dcgrid_env.apps.importers.gridlabd.glm_text import GlmFile
from dcgrid_env.apps.importers.gridlabd.line_impedances import line_matrices
from dcgrid_env.apps.importers.import_report import Report

MODEL = """
object overhead_line_conductor { name big; geometric_mean_radius 0.0313; diameter 0.927 in; resistance 0.1859; }
object overhead_line_conductor { name small; geometric_mean_radius 0.00814; diameter 0.563 in; resistance 0.592; }
object underground_line_conductor { name cn; outer_diameter 1.29; conductor_gmr 0.0171; conductor_diameter 0.567;
    conductor_resistance 0.41; neutral_gmr 0.00208; neutral_resistance 14.872; neutral_diameter 0.0641;
    neutral_strands 13; insulation_relative_permitivitty 2.3; }
object underground_line_conductor { name ts; conductor_gmr 0.0111; conductor_diameter 0.368; outer_diameter 1.06;
    conductor_resistance 0.97; shield_gmr 0.036458; shield_resistance 4.2786; insulation_relative_permitivitty 2.3; }
object underground_line_conductor { name n; conductor_gmr 0.01113; conductor_resistance 0.607; }
object line_spacing { name pole; distance_AB 2.5; distance_AC 4.5; distance_BC 7.0; distance_BN 5.656854;
    distance_AN 4.272002; distance_CN 5.0; distance_AE 28; distance_BE 28; distance_CE 28; distance_NE 24; }
object line_spacing { name trench; distance_AB 6 in; distance_BC 6 in; distance_AC 1 ft; distance_AN 1 in; }
object line_configuration { name c601; conductor_A big; conductor_B big; conductor_C big; conductor_N small;
    spacing pole; }
object line_configuration { name c606; conductor_A cn; conductor_B cn; conductor_C cn; spacing trench; }
object line_configuration { name c607; conductor_A ts; conductor_N n; spacing trench; }
object overhead_line { name 601; phases ABCN; configuration c601; }
object underground_line { name 606; phases ABC; configuration c606; }
object underground_line { name 607; phases AN; configuration c607; }
"""
PUBLISHED = {
    "601": ([[0.3465 + 1.0179j, 0.1560 + 0.5017j, 0.1580 + 0.4236j], [0, 0.3375 + 1.0478j, 0.1535 + 0.3849j],
             [0, 0, 0.3414 + 1.0348j]], [[6.2998, -1.9958, -1.2595], [0, 5.9597, -0.7417], [0, 0, 5.6386]]),
    "606": ([[0.7982 + 0.4463j, 0.3192 + 0.0328j, 0.2849 - 0.0143j], [0, 0.7891 + 0.4041j, 0.3192 + 0.0328j],
             [0, 0, 0.7982 + 0.4463j]], np.diag([96.8897] * 3)),
    "607": ([[1.3425 + 0.5124j]], [[88.9912]]),
}  # fmt: skip


@pytest.mark.parametrize("name", PUBLISHED)
def test_matrices_are_those_that_ieee_publishes(name, tmp_path):
    path = tmp_path / "m.glm"
    path.write_text(MODEL)
    model = Model(GlmFile(path))
    line = next(item for item in model.file.objects if item.name == name)
    z, c = line_matrices(model, line, "ABC"[: len(PUBLISHED[name][0])], 60.0, Report("model"))
    published_z, published_b = (np.triu(m) for m in PUBLISHED[name])
    np.testing.assert_allclose(np.triu(z), published_z, rtol=0.0, atol=1e-3)
    np.testing.assert_allclose(np.triu(c) * 2e-3 * np.pi * 60.0, published_b, rtol=1e-2)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("geometric_mean_radius 0.0313; ", "", "overhead_line_conductor big: geometric_mean_radius is missing; add it"),
        ("resistance 0.1859", "resistance 0", "resistance '0' must be positive"),
        ("distance_BC 7.0", "distance_BC -7.0", "line_spacing pole: distance_BC '-7.0' must not be negative"),
        ("conductor_B big", "conductor_B none", "conductor_B 'none' is no object of the model"),
        (
            "conductor_B big",
            "conductor_B cn",
            "is a underground_line_conductor; must be one of overhead_line_conductor",
        ),
        ("conductor_A big;", "z11 1; z12 1; z21 2;", "z12 '1' makes the matrix asymmetric"),
    ],
)
def test_errors_name_object_property_and_value(old, new, said, tmp_path):
    path = tmp_path / "m.glm"
    path.write_text(MODEL.replace(old, new))
    model = Model(GlmFile(path))
    line = next(item for item in model.file.objects if item.name == "601")
    with pytest.raises(FeederError, match=said):
        line_matrices(model, line, "ABC", 60.0, Report("model"))
