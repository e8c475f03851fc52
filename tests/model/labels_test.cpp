#include <gtest/gtest.h>

#include "model/card.h"
#include "support/error_of.h"
#include "tt3d/model.h"

namespace tt3d::model {
namespace {

ModelCard imagenet_card() {
  ModelCard card;
  card.name = "net";
  for (const auto& one : model::imagenet_classes()) {
    card.labels.push_back(one.names.front());
    card.wnids.push_back(one.wnid);
  }
  return card;
}

std::string error_of(const std::string& text) {
  try {
    (void)find_class(text, imagenet_card());
  } catch (const InputError& error) {
    return error.what();
  }
  return "";
}

TEST(Labels, TableHasAThousandClasses) {
  ASSERT_EQ(model::imagenet_classes().size(), 1000U);
  EXPECT_EQ(model::imagenet_classes()[0].wnid, "n01440764");
  EXPECT_EQ(model::imagenet_classes()[2].names.size(), 5U);
  EXPECT_EQ(model::imagenet_classes()[999].names.front(), "toilet tissue");
}

TEST(Labels, ByIndexWordNetIdAndName) {
  const ModelCard card = imagenet_card();
  for (const std::string text : {"849", "n04398044", "teapot", "Teapot"}) {
    const ClassId id = find_class(text, card);
    EXPECT_EQ(id.index, 849) << text;
    EXPECT_EQ(id.wnid, "n04398044");
    EXPECT_EQ(id.name, "teapot");
  }
  EXPECT_EQ(find_class("man-eater", card).index, 2) << "a synonym";
  EXPECT_EQ(find_class("tench, Tinca tinca", card).index, 0) << "the whole entry";
}

ModelCard coco_card() {
  ModelCard card;
  card.name = "ssd";
  card.label_set = "coco";
  card.labels = {"person", "bird", "hot dog"};
  return card;
}

TEST(Labels, AClassForEachLabelSet) {
  ModelCard imagenet = imagenet_card();
  imagenet.label_set = "imagenet-1k";
  for (const std::string text :
       {"imagenet=hen,coco=bird", "coco=bird, imagenet-1k=hen", "imagenet=8,coco=1",
        "ssd=bird,net=hen", "COCO=bird,ImageNet=hen"}) {
    EXPECT_EQ(find_class(text, imagenet).index, 8) << text;
    EXPECT_EQ(find_class(text, coco_card()).index, 1) << text;
  }
  // A comma inside a name.
  EXPECT_EQ(find_class("imagenet=tench, Tinca tinca,coco=hot dog", imagenet).index, 0);
  EXPECT_EQ(find_class("imagenet=tench, Tinca tinca,coco=hot dog", coco_card()).index, 2);
}

TEST(Labels, AMissingLabelSetIsNamed) {
  for (const std::string text : {"imagenet=hen", "imagenet=hen,", "imagenet="}) {
    const std::string error = testing::error_of([&] { (void)find_class(text, coco_card()); });
    EXPECT_FALSE(error.empty()) << text;
  }
  EXPECT_EQ(testing::error_of([] { (void)find_class("imagenet=hen", coco_card()); }),
            "class 'imagenet=hen': has no class for model ssd; add coco=CLASS");
}

TEST(Labels, ABareIndexOverDifferentLabelsIsRefused) {
  const ModelCard imagenet = imagenet_card(), coco = coco_card();
  check_same_class("8", {&imagenet, &imagenet}, "target");
  check_same_class("hen", {&imagenet, &coco}, "target");
  check_same_class("imagenet=8,coco=1", {&imagenet, &coco}, "target");
  const std::string error = testing::error_of([&] {
    check_same_class("1", {&imagenet, &coco}, "target");
  });
  EXPECT_EQ(error.find("target 1: an index means another class in ssd than in net"), 0U) << error;
}

TEST(Labels, AmbiguousNameListsCandidates) {
  const std::string text = error_of("crane");
  EXPECT_NE(text.find("ambiguous"), std::string::npos) << text;
  EXPECT_NE(text.find("134 n02012849"), std::string::npos) << text;
  EXPECT_NE(text.find("517 n03126707"), std::string::npos) << text;
}

TEST(Labels, UnknownNamesSuggestNearOnes) {
  EXPECT_NE(error_of("teapott").find("'teapot'"), std::string::npos);
  EXPECT_NE(error_of("1000").find("0 to 999"), std::string::npos);
  EXPECT_NE(error_of("n99999999").find("WordNet"), std::string::npos);
  EXPECT_NE(error_of("").find("no such class"), std::string::npos);
}

}  // namespace
}  // namespace tt3d::model
