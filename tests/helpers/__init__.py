"""What several test modules share: small scenes, numpy helpers, files of other tools. No tests in here."""
