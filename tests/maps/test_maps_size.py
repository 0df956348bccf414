"""A map that no memory holds is refused before it is computed."""

import pytest

from cellpilot.errors import InputError
from cellpilot.maps import simulate_map
from cellpilot.radio import hexagonal_deployment


def test_a_map_of_too_many_cells_is_refused() -> None:
    with pytest.raises(InputError, match="1,600,000,000 cells; at most 10,000,000"):
        simulate_map(hexagonal_deployment(), bin_m=0.01)
