"""What several test modules share: recordings that they write themselves, stand-ins, and known answers."""
