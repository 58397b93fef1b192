"""What the benchmark commands share: the machine they ran on, timing, and results as JSON and tables in the documents."""
