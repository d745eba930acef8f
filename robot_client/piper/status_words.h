#pragma once

#include <cstdint>
#include <string>

#include "robot_client/piper/protocol.h"

// What the codes of an arm's frames mean, for a person. Every function answers for every value: one
// that no list has is named by its number.
namespace robostress::piper {

std::string WordsOf(ControlMode mode);  // "commands over CAN"
std::string WordsOf(MoveMode mode);     // "J (joint targets)"
std::string WordsOf(StatusCode code);   // "collision protection has stopped the arm"
// Byte 3 of 0x2A1: "off", "recording", ...
std::string TeachWords(uint8_t teach);
// The faults among DriverBit, "under-voltage, stalled motor"; empty: none of them. Whether the
// driver is enabled is no fault.
std::string DriverFaultWords(uint8_t bits);
// The same for GripperStatus::errors.
std::string GripperFaultWords(uint8_t errors);
// What a frame of the arm carries, "joint angles J1 J2"; empty: an identifier that is not known.
std::string ReportWords(uint16_t id);

}  // namespace robostress::piper
