"""File formats: codecs, transfer curves, atomic writing. Independent of scenes."""
