    CREATE TABLE seasons (
        number INTEGER PRIMARY KEY AUTOINCREMENT,
        name TEXT NOT NULL UNIQUE,
        document TEXT NOT NULL,
        signature BLOB NOT NULL,
        secret BLOB NOT NULL,
        closed_ms INTEGER
    ) STRICT;
