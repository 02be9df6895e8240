"""`python -m idfslam.cli`: the command line where no script is installed."""

from idfslam.cli.command_line import main

if __name__ == "__main__":
    main()
