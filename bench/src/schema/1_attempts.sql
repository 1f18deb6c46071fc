    CREATE TABLE secrets (name TEXT PRIMARY KEY, value BLOB NOT NULL) STRICT;
    CREATE TABLE attempts (
        number INTEGER PRIMARY KEY AUTOINCREMENT,
        id TEXT NOT NULL UNIQUE,
        scenario TEXT NOT NULL,
        team TEXT NOT NULL,
        controller TEXT NOT NULL,
        begun_ms INTEGER NOT NULL,
        status TEXT NOT NULL,
        document TEXT NOT NULL,
        signature BLOB NOT NULL,
        actions BLOB
    ) STRICT;
    CREATE INDEX attempts_by_scenario ON attempts (scenario);
    CREATE INDEX attempts_by_team ON attempts (team, begun_ms);
    CREATE INDEX attempts_running ON attempts (begun_ms) WHERE status = 'running';
    CREATE TABLE tokens (
        number INTEGER PRIMARY KEY AUTOINCREMENT,
        team TEXT NOT NULL,
        hash BLOB NOT NULL UNIQUE,
        created_ms INTEGER NOT NULL,
        revoked_ms INTEGER
    ) STRICT;
