"""`python -m shipfp_rs.cli`: the command `shipfp`."""

import sys

from shipfp_rs.cli import main

sys.exit(main())
