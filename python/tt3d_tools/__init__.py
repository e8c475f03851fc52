"""Python tools of tt3d: model exporters, drivers of other renderers, unwrapping, print checks."""
