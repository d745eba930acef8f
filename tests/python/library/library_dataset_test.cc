// Data sets through the C interface: what C callers can get wrong. What is written is read back in
// tests/python/package/dataset_test.py.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <string>
#include <vector>

#include "robostress.h"

namespace {

using ::testing::HasSubstr;

class LibraryDataset : public testing::Test {
 protected:
  LibraryDataset() { std::filesystem::remove_all(folder_); }
  ~LibraryDataset() override { robostress_dataset_free(set_); }

  robostress_code Open() {
    return robostress_dataset_open(folder_.c_str(), &schema_, &set_, error_, sizeof error_);
  }
  robostress_code Append() {
    return robostress_dataset_append(set_, &frames_, error_, sizeof error_);
  }
  void Refuses(robostress_code code, const std::string& message) {
    EXPECT_EQ(code, ROBOSTRESS_INVALID_ARGUMENT);
    EXPECT_THAT(std::string(error_), HasSubstr(message));
    EXPECT_EQ(robostress_dataset_episodes(set_), 0u);
  }

  const std::string folder_ = ::testing::TempDir() + "/library_dataset";
  const char* names_[1] = {"action"};
  const char* axes_[2] = {"x", "y"};
  const char* const* axis_names_[1] = {axes_};
  size_t counts_[1] = {2};
  const char* cameras_[1] = {"image"};
  robostress_schema schema_ = {
      sizeof(robostress_schema), "arm", 20, 1, names_, counts_, axis_names_, 1, cameras_};
  std::vector<float> action_ = {1, 2, 3, 4};
  const float* vectors_[1] = {action_.data()};
  std::vector<unsigned char> pixels_ = std::vector<unsigned char>(2 * 4 * 4 * 3, 7), png_ = {1, 2};
  const unsigned char* pixel_rows_[1] = {pixels_.data()};
  const unsigned char* pictures_[1] = {png_.data()};
  size_t ends_[2] = {1, 2};
  const size_t* end_rows_[1] = {ends_};
  int width_[1] = {4}, height_[1] = {4};
  robostress_frames frames_ = {sizeof(robostress_frames),
                               "go",
                               1,
                               2,
                               vectors_,
                               pixel_rows_,
                               width_,
                               height_,
                               pictures_,
                               end_rows_};
  robostress_dataset* set_ = nullptr;
  char error_[512] = "";
};

TEST_F(LibraryDataset, HoldsWholeEpisodes) {
  ASSERT_EQ(Open(), ROBOSTRESS_OK) << error_;
  ASSERT_EQ(Append(), ROBOSTRESS_OK) << error_;
  ASSERT_EQ(Append(), ROBOSTRESS_OK) << error_;
  EXPECT_EQ(robostress_dataset_episodes(set_), 2u);
  EXPECT_EQ(robostress_dataset_steps(set_), 4u);
  robostress_dataset_free(set_);
  set_ = nullptr;
  ASSERT_EQ(Open(), ROBOSTRESS_OK) << error_;
  EXPECT_EQ(robostress_dataset_episodes(set_), 2u);
}

TEST_F(LibraryDataset, AFolderHasOneRecorder) {
  ASSERT_EQ(Open(), ROBOSTRESS_OK) << error_;
  robostress_dataset* second = nullptr;
  EXPECT_EQ(robostress_dataset_open(folder_.c_str(), &schema_, &second, error_, sizeof error_),
            ROBOSTRESS_WRONG_ORDER);
  EXPECT_THAT(std::string(error_), HasSubstr("one recorder a folder"));
}

TEST_F(LibraryDataset, WhatTheDiskRefusesIsNoFaultOfTheLibrary) {
  EXPECT_EQ(robostress_dataset_open("/dev/null/set", &schema_, &set_, error_, sizeof error_),
            ROBOSTRESS_STORAGE);
  EXPECT_THAT(std::string(error_), HasSubstr("/dev/null/set"));
}

TEST_F(LibraryDataset, ASchemaThatIsNoneIsRefused) {
  schema_.size = 4;
  Refuses(Open(), "schema.size is 4");
  schema_.size = sizeof schema_;
  schema_.rate = 0;
  Refuses(Open(), "0 Hz");
  schema_.rate = 20;
  schema_.axis_counts = nullptr;
  Refuses(Open(), "schema.axis_counts is NULL");
  schema_.axis_counts = counts_;
  counts_[0] = 0;
  Refuses(Open(), "feature 'action' has no axes");
  counts_[0] = SIZE_MAX;
  Refuses(Open(), "must be at most 1000");
  counts_[0] = 2;
  names_[0] = "a/b";
  Refuses(Open(), "feature 'a/b'");
  names_[0] = "task_index";
  Refuses(Open(), "there is a feature task_index already");
  names_[0] = "action";
  cameras_[0] = nullptr;
  Refuses(Open(), "schema.camera_names is NULL");
  EXPECT_EQ(robostress_dataset_open(nullptr, &schema_, &set_, nullptr, 0),
            ROBOSTRESS_INVALID_ARGUMENT);
  EXPECT_EQ(robostress_dataset_episodes(nullptr), 0u);
}

TEST_F(LibraryDataset, FramesThatAreNoneAreRefused) {
  ASSERT_EQ(Open(), ROBOSTRESS_OK) << error_;
  frames_.steps = 0;
  Refuses(Append(), "no steps");
  frames_.steps = SIZE_MAX;
  Refuses(Append(), "must be at most 1000000");
  frames_.steps = 2;
  frames_.instruction = nullptr;
  Refuses(Append(), "frames.instruction is NULL");
  frames_.instruction = "go";
  vectors_[0] = nullptr;
  Refuses(Append(), "frames.vectors is NULL");
  vectors_[0] = action_.data();
  action_[3] = std::numeric_limits<float>::infinity();
  Refuses(Append(), "feature action holds inf");
  action_[3] = 4;
  height_[0] = -4;
  Refuses(Append(), "camera 'image' is 4 x -4 pixels");
  height_[0] = 4;
  ends_[1] = 0;
  Refuses(Append(), "picture 1 ends at 0, before 1");
  ends_[1] = 2;
  frames_.pixels = nullptr;
  Refuses(Append(), "is NULL");
  frames_.pixels = pixel_rows_;
  EXPECT_EQ(robostress_dataset_append(nullptr, &frames_, nullptr, 0), ROBOSTRESS_INVALID_ARGUMENT);
  EXPECT_EQ(Append(), ROBOSTRESS_OK) << error_;
}

}  // namespace
