"""What an image is worth: masked and whole-image metrics, silhouettes, colour calibration. No gradients."""
