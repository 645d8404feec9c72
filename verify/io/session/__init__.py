"""A recorded session: keys, folder, pictures or poses."""
