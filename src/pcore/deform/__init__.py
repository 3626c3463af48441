"""Pure maps R^3 -> R^3 of edits and fine-tuning."""
