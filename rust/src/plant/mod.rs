//! The nonlinear propulsion plant in bollard pull, one file a component.
