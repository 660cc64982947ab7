"""``python -m excavatwin``."""

from __future__ import annotations

import sys

from excavatwin.cli import main

if __name__ == "__main__":
    sys.exit(main())
