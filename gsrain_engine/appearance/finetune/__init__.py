"""Fine-tuning the transfer model."""
