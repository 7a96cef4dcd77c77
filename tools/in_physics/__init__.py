"""What grasps and skills come to when physics carries them out."""
