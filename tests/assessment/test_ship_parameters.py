"""Ships that have given linear parameters."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from shipfp_rs.assessment.si import parameters_of, with_parameters
from shipfp_rs.errors import InputError
from shipfp_rs.vessel.vessel import Vessel


@given(
    st.fixed_dictionaries(
        {
            "tau_n": st.floats(0.9, 1.5),
            "tau_prop": st.floats(0.2, 0.6),
            "g": st.floats(-0.9, -0.3),
            "vK_p": st.floats(3.0, 8.0),
            "vK_i": st.floats(8.0, 20.0),
            "p": st.floats(1.9, 2.4),
            "T_d": st.floats(0.06, 0.2),
            # A file of a vessel takes no time that is next to nothing.
            "T_set": st.just(0.0) | st.floats(1e-9, 0.5),
            "tau_act": st.just(0.0) | st.floats(1e-9, 0.1),
            "tau_twist": st.floats(1e-4, 1e-3),
        }
    )
)
@settings(max_examples=10)
def test_a_ship_with_given_parameters_has_them(values: dict[str, float]) -> None:
    found = parameters_of(with_parameters(Vessel.load("stan-tug-1205-full"), values))
    for name, value in values.items():
        assert found[name] == pytest.approx(value, rel=1e-6, abs=1e-9), name


def test_a_parameter_that_no_ship_has_is_named() -> None:
    with pytest.raises(InputError, match="found parameters misread, expected some of K_i, K_p"):
        with_parameters(Vessel.load("stan-launch-804"), {"misread": 0.1})
