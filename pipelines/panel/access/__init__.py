"""Who may use the panel: the guard against other sites, tokens for other machines, and the login that asks for them."""
