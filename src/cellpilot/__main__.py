"""`python -m cellpilot`."""

import sys

from cellpilot.cli.main import main

sys.exit(main())
