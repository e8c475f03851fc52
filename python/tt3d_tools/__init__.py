"""Python helpers of tt3d: exporters, drivers of other renderers, unwrapping."""
