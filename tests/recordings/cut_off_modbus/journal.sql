BEGIN TRANSACTION;
CREATE TABLE events (
    seq INTEGER PRIMARY KEY AUTOINCREMENT, run TEXT NOT NULL REFERENCES runs(id),
    at REAL NOT NULL, text TEXT NOT NULL
);
CREATE TABLE intents (
    seq INTEGER PRIMARY KEY AUTOINCREMENT, run TEXT NOT NULL REFERENCES runs(id),
    kind TEXT NOT NULL, parameter TEXT NOT NULL, old INTEGER NOT NULL, new INTEGER NOT NULL,
    state TEXT NOT NULL, at REAL NOT NULL
);
INSERT INTO "intents" VALUES(1,'20261126-002213-axis','experiment','max_torque',3000,1000,'verified',1.79565253379078483587e+09);
INSERT INTO "intents" VALUES(2,'20261126-002213-axis','experiment','max_speed',28648,14691,'verified',1.79565253379201745986e+09);
INSERT INTO "intents" VALUES(3,'20261126-002213-axis','experiment','abort_connection_option',1,3,'verified',1.79565253379334473608e+09);
INSERT INTO "intents" VALUES(4,'20261126-002213-axis','experiment','torque_target',0,0,'verified',1.79565253379412698752e+09);
INSERT INTO "intents" VALUES(5,'20261126-002213-axis','experiment','position_target',0,0,'verified',1.79565253379493427274e+09);
INSERT INTO "intents" VALUES(6,'20261126-002213-axis','experiment','mode_of_operation',0,8,'verified',1.79565253379643559455e+09);
INSERT INTO "intents" VALUES(7,'20261126-002213-axis','experiment','mode_of_operation',8,10,'verified',1.79565253379783368106e+09);
INSERT INTO "intents" VALUES(8,'20261126-002213-axis','experiment','max_speed',14691,28648,'verified',1.79565253390316128733e+09);
CREATE TABLE runs (
    id TEXT PRIMARY KEY, created REAL NOT NULL, axis TEXT NOT NULL, link TEXT NOT NULL,
    profile TEXT NOT NULL, profile_hash TEXT NOT NULL, serial TEXT NOT NULL,
    status TEXT NOT NULL, context TEXT NOT NULL
);
INSERT INTO "runs" VALUES('20261126-002213-axis',1.79565253378672409064e+09,'axis','LINK','own','33279c038777deae258abdb1e3d03466f7bc0640f87875d07da316887034a991','0xAD3B31AF','running','{"axis": {"name": "axis", "link": "LINK", "profile": "own.toml", "travel": null, "cycle": null, "rated_torque": null, "torque_constant": null, "encoder": null, "mechanics": {"motion": "rotary", "gear": 1.0, "feed": null, "held_by": "friction"}, "limits": {"torque": null, "speed": null, "duration": 300.0, "watchdog": null}, "group": null}, "fraction": 0.85, "pid": 17666}');
CREATE INDEX intents_of_run ON intents(run);
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('intents',8);
COMMIT;
