"""Files in and out: codecs, transfer curves, atomic writing. Knows no scenes."""
