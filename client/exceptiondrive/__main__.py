"""`python -m exceptiondrive`."""

from exceptiondrive.cli import main

main()
