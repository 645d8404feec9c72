"""The Robotiq gripper over Modbus: registers, reader, orders."""
