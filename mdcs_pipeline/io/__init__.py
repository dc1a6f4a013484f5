"""Files in and out: arrays and skeletons, no stages."""
