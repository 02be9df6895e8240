"""Programs that another Python runs, in an environment that has the peer's package. They import nothing of idf-slam but what lies here."""
