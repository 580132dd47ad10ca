"""What every process sets before it loads linear algebra."""

# How many threads share a sum decides how it is rounded, and a decision must not depend on where it was made.
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
