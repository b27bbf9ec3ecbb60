"""The formats of seismology and geodesy, from a bag and live."""
