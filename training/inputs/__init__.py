"""What a training is made of: settings, labeled pictures, draws, and augmentation."""
