"""What the engine claims of itself, measured: time, accuracy, sizes of programs."""
