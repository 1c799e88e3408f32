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
INSERT INTO "intents" VALUES(1,'20261126-002215-axis','experiment','max_torque',3000,1000,'verified',1.79565253597519230849e+09);
INSERT INTO "intents" VALUES(2,'20261126-002215-axis','experiment','max_speed',2865,1469,'verified',1.79565253597668027882e+09);
INSERT INTO "intents" VALUES(3,'20261126-002215-axis','experiment','watchdog_time',50,8323122,'verified',1.79565253597793602941e+09);
INSERT INTO "intents" VALUES(4,'20261126-002215-axis','experiment','abort_connection_option',1,3,'verified',1.79565253597922134401e+09);
INSERT INTO "intents" VALUES(5,'20261126-002215-axis','experiment','position_target',0,0,'verified',1.79565253598018741611e+09);
INSERT INTO "intents" VALUES(6,'20261126-002215-axis','experiment','torque_target',0,0,'verified',1.79565253598115181924e+09);
INSERT INTO "intents" VALUES(7,'20261126-002215-axis','experiment','1400h:01',517,517,'intended',1.79565253598290610311e+09);
INSERT INTO "intents" VALUES(8,'20261126-002215-axis','experiment','1400h:02',255,255,'intended',1.79565253598327088362e+09);
INSERT INTO "intents" VALUES(9,'20261126-002215-axis','experiment','1600h:00',1,3,'intended',1.79565253598356771476e+09);
INSERT INTO "intents" VALUES(10,'20261126-002215-axis','experiment','1600h:01',1614807056,1614807056,'intended',1.79565253598394036294e+09);
INSERT INTO "intents" VALUES(11,'20261126-002215-axis','experiment','1800h:01',389,389,'intended',1.79565253598424863813e+09);
INSERT INTO "intents" VALUES(12,'20261126-002215-axis','experiment','1800h:02',255,1,'intended',1.79565253598455762864e+09);
INSERT INTO "intents" VALUES(13,'20261126-002215-axis','experiment','1A00h:00',1,3,'intended',1.79565253598509097098e+09);
INSERT INTO "intents" VALUES(14,'20261126-002215-axis','experiment','1A00h:01',1614872592,1614872592,'intended',1.79565253598540878294e+09);
INSERT INTO "intents" VALUES(15,'20261126-002215-axis','experiment','mode_of_operation',0,8,'verified',1.79565253598717164992e+09);
INSERT INTO "intents" VALUES(16,'20261126-002215-axis','experiment','mode_of_operation',8,10,'verified',1795652535.98878);
INSERT INTO "intents" VALUES(17,'20261126-002215-axis','experiment','max_speed',1469,2865,'verified',1.79565253609746313095e+09);
CREATE TABLE runs (
    id TEXT PRIMARY KEY, created REAL NOT NULL, axis TEXT NOT NULL, link TEXT NOT NULL,
    profile TEXT NOT NULL, profile_hash TEXT NOT NULL, serial TEXT NOT NULL,
    status TEXT NOT NULL, context TEXT NOT NULL
);
INSERT INTO "runs" VALUES('20261126-002215-axis',1.795652535970938921e+09,'axis','LINK','own','5a9c8b9a71ae55bae663467899d3a5d05c2d3249d44b1e7e043a0c7c664226c4','0xAD3B31AF','running','{"axis": {"name": "axis", "link": "LINK", "profile": "own.toml", "travel": null, "cycle": null, "rated_torque": null, "torque_constant": null, "encoder": null, "mechanics": {"motion": "rotary", "gear": 1.0, "feed": null, "held_by": "friction"}, "limits": {"torque": null, "speed": null, "duration": 300.0, "watchdog": null}, "group": null}, "fraction": 0.85, "pid": 17670}');
CREATE INDEX intents_of_run ON intents(run);
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('intents',17);
COMMIT;
