"""Sine fits and frequency responses, each point with its uncertainty."""

from shipfp_rs.frequency.lines import Lines, fit_lines, fit_sine
from shipfp_rs.frequency.spectra import FrequencyResponse, sine_response, spectral_response
from shipfp_rs.frequency.tones import local_response, multisine_response, stepped_sine_response

__all__ = [
    "FrequencyResponse",
    "Lines",
    "fit_lines",
    "fit_sine",
    "local_response",
    "multisine_response",
    "sine_response",
    "spectral_response",
    "stepped_sine_response",
]
