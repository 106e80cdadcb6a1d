"""What command lines have in common."""

RESUME = "run the same again to resume from"
SMALL = ["--theta", "0.05", "0.35", "30", "--sum", "-0.03", "0.01", "20"]
