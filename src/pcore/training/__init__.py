"""Pre-training of PAPR and the self-supervised fine-tuning of P-CORE."""
