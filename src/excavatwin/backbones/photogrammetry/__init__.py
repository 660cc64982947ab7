"""Photos to world points on the CPU, without weights: structure from motion, then dense multi-view depth."""
