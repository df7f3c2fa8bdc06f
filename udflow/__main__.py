"""`python -m udflow` is the command line."""

from udflow.cli import main

raise SystemExit(main())
