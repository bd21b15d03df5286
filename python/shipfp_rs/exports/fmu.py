"""A Functional Mock-up Unit (FMI 2.0, co-simulation) of a fingerprint's ship, by PythonFMU."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from hashlib import sha256
from pathlib import Path
from shutil import copyfile
from zipfile import is_zipfile

from shipfp_rs import _core
from shipfp_rs.errors import ShipfpError
from shipfp_rs.exports import blocks
from shipfp_rs.exports.drive import Drive
from shipfp_rs.support.files import replacing
from shipfp_rs.support.tables import package

SLAVE = """

from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real

PARAMETERS = {parameters}
TEXTS = {texts}
BLOCKS = {blocks}
INPUTS, OUTPUTS = {inputs}, {outputs}


class Ship(Fmi2Slave):
    author = "shipfp_rs {version}"
    description = {name!r}

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        for name, value in PARAMETERS.items():
            setattr(self, name, value)
            kind = dict(causality=Fmi2Causality.parameter, variability=Fmi2Variability.fixed)
            self.register_variable(Real(name, description=TEXTS[name], **kind))
        for signals, causality in ((INPUTS, Fmi2Causality.input), (OUTPUTS, Fmi2Causality.output)):
            for block, name in signals.items():
                setattr(self, name, PARAMETERS["load_0" if block == "load" else name + "_0"])
                self.register_variable(Real(name, causality=causality, description=TEXTS[name]))
        self.model = None

    def exit_initialization_mode(self):
        self.model = Model([Block(*one) for one in BLOCKS], {{name: getattr(self, name) for name in PARAMETERS}})

    def do_step(self, current_time, step_size):
        self.model.feed(**{{block: getattr(self, name) for block, name in INPUTS.items()}})
        self.model.advance(step_size)
        found = self.model.signals()
        for block, name in OUTPUTS.items():
            setattr(self, name, getattr(self, name + "_0") * (1.0 + found[block]))
        return True
"""


def write_fmu(drive: Drive, path: Path) -> Path:
    """Write a ship as an FMU; `InputError` if PythonFMU is not installed, or the file can't be written."""
    package("pythonfmu", extra="fmu")
    named = [*drive.parameters, *drive.inputs.values(), *drive.outputs.values()]
    text = Path(blocks.__file__).read_text(encoding="utf-8") + SLAVE.format(
        name=drive.name,
        version=_core.__version__,
        parameters=drive.parameters,
        texts={name: drive.described(name) for name in named},
        blocks=[tuple(block) for block in drive.blocks],
        inputs=drive.inputs,
        outputs=drive.outputs,
    )
    # The module's name is unique: all FMUs of a tool share one interpreter, which loads a module of one name only once.
    script = f"ship_{sha256(text.encode()).hexdigest()[:16]}.py"
    with tempfile.TemporaryDirectory() as folder:
        made = Path(folder) / "ship.fmu"
        (Path(folder) / script).write_text(text, encoding="utf-8")
        # PythonFMU runs in a separate process, since it imports the script and leaves it imported.
        words = [sys.executable, "-m", "pythonfmu", "build", "-f", script, "-d", str(made)]
        run = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False)
        if run.returncode or not is_zipfile(made):
            raise ShipfpError(f"PythonFMU built no FMU: {(run.stderr.strip() or run.stdout.strip())[-300:]}")
        with replacing(path) as temporary:
            copyfile(made, temporary)
    return path
