"""Safe reading of untrusted files and streams: limits before allocation, errors in one sentence."""
