"""Files of ours: models, run folders, training states, headers, and official checkpoints."""
