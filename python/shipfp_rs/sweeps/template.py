"""The commented SWEEP.toml that `shipfp init --sweep` writes."""

SWEEP_TEMPLATE = """\
# A sweep: many simulated trials, each identified. Run it with `shipfp sweep SWEEP.toml`.

[sweep]
name = "Sweep"
vessel = "stan-launch-804"      # built-in ship, or the path of a vessel file
chain = "experiment"            # simulate, identify; "log": simulate a raw log with sensors and faults, process, identify
design = "latin"                # "latin" hypercube, "sobol", "random", or "grid"
draws = 1000                    # for a grid in its place: repeats = 25, of each of its cells
seed = 0                        # every draw's own seed follows from this one and its index
# time_limit_s = 60.0           # of a draw; with one, results depend on how fast the machine is

# What varies: any value of the tables below, and any of the vessel's file as "vessel.section.key".
[factors]
"excitation.duration_s" = { low = 30.0, high = 300.0, scale = "log" }
"excitation.amplitude_rpm" = { values = [13.0, 26.0, 52.0] }
"noise.level" = { low = 0.5, high = 2.0, scale = "log" }
"vessel.shaft.inertia_kg_m2" = { mean = 21.2, std = 0.5 }
# "operating_point.n_e_rpm" = { low = 1000.0, high = 1300.0, points = 4 }  # points: levels in a grid

[excitation]                    # of what is put on the set point
kind = "chirp"                  # "chirp", "steps", "multisine", "sines", "prbs", "noise"
duration_s = 120.0
amplitude_rpm = 40.0
start_hz = 0.02                 # two periods in the duration where it isn't given
stop_hz = 5.0
rate_hz = 50.0                  # sample rate of the experiment

[noise]                         # standard deviations over the operating point, for the chain "experiment"
n_e = 0.002
M_b = 0.01
level = 1.0                     # multiplies all of them
correlation = 0.5               # of successive samples

# [operating_point]
# n_e_rpm = 1200.0              # the ship's own where it isn't given

# [vessel]                      # values in place of those in the ship's file
# "propeller.torque_exponent" = 2.1

# [sensors]                     # for the chain "log": the logger and its noise
# rate_hz = 2000.0
# torque_noise_V = 0.02
# steady_s = 60.0               # steady stretch before the excitation

# [faults]                      # for the chain "log": so many a minute
# A = 6.0                       # double crossings of the pulse trains
# B = 2.0                       # lost pulses
# C = 3.0                       # radio interference on the torque
# D1 = 2.0                      # relay jumps of the set point

[identify]                      # as in TRIAL.toml, without seed
products = true                 # fit vK_p and vK_i, which speed and torque tell, in place of v, K_p and K_i
noise = "ar"                    # "ar": coloured; "white"; "innovations": disturbances of the drive train itself
starts = 1
"""
"""Valid as it stands."""
