"""Entry of ``python -m benchmarks.topology``."""

import sys

from benchmarks.topology.run import main

if __name__ == "__main__":
    sys.exit(main())
