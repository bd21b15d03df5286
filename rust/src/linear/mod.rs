//! The linear structure: exact discretisation, simulation, sensitivities, frequency response.
