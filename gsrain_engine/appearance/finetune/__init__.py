"""Fine-tuning of CycleGAN-Turbo on unpaired clear and rainy images."""
