"""What pcore costs, measured: `python -m benchmarks speed` and `python -m benchmarks gpu`."""
