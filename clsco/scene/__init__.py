"""What a user means: scenes, their files, sweeps. Knows nothing of how they are rendered."""
