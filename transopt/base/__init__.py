"""What every room may lean on: errors, files, signals, plotting, the console; it knows nothing of haptics."""
