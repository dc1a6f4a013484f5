"""``python -m mdcs_pipeline``: the same as the command ``mdcs``."""

from mdcs_pipeline.cli import main

if __name__ == "__main__":
    main()
