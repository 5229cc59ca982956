"""Scenes as users write them: models, scene files, sweeps. Independent of how they are rendered."""
