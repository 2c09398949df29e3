"""Seeds as they are given."""

import numpy as np
import pytest

from dcgrid_env.core.seeds import as_seed, whole_seed


@pytest.mark.parametrize("seed", [0, 7, 2**80, np.int32(5), np.uint64(2**63)])
def test_whole_numbers_become_pythons(seed):
    for found in (as_seed(seed), whole_seed(seed)):
        assert type(found) is int
        assert found == seed


def test_none_is_the_next_episode_where_there_is_one():
    assert as_seed(None) is None
    with pytest.raises(ValueError, match="seed is None; give a whole number of at least 0"):
        whole_seed(None)


@pytest.mark.parametrize("seed", [-1, 1.0, True, "1", float("nan"), [0], np.int64(-1), np.bool_(True)])
def test_the_rest_is_refused(seed):
    with pytest.raises(ValueError, match=r"seed is .*; give a whole number of at least 0"):
        as_seed(seed)
