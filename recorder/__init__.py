"""The shop-floor edge: Zenoh in, one MCAP file per demonstration out."""
