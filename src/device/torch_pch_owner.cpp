// Owns the precompiled ATen header that every target with torch shares.
