"""The centre's database: schema, migrations, roles, partitions."""
