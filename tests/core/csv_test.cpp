#include "tt3d/csv.h"

#include <gtest/gtest.h>

#include <cstdint>

#include "support/error_of.h"
#include "support/temporary_folder.h"
#include "tt3d/core.h"

namespace tt3d {
namespace {

using testing::error_of;
using Cells = std::vector<std::string>;
using Rows = std::vector<Cells>;

CsvTable parse(const std::string& text, const Cells& names = {}) {
  return parse_csv(text, "t.csv", names);
}

std::string error(const std::string& text, const Cells& names = {}) {
  return error_of([&] { (void)parse(text, names); });
}

TEST(Csv, HeaderRowsAndLineNumbers) {
  const CsvTable table = parse("a,b\n1,2\n3,\n");
  EXPECT_EQ(table.names, (Cells{"a", "b"}));
  EXPECT_EQ(table.rows, (Rows{{"1", "2"}, {"3", ""}}));
  EXPECT_EQ(table.lines, (std::vector<long>{2, 3}));
  EXPECT_EQ(table.path.string(), "t.csv");
}

TEST(Csv, TheLastLineNeedsNoNewline) {
  EXPECT_EQ(parse("a,b\n1,2").rows, (Rows{{"1", "2"}}));
  EXPECT_TRUE(parse("a,b").rows.empty());
}

TEST(Csv, QuotedCellsHoldCommasAndQuotes) {
  const CsvTable table = parse("a,\"b, c\"\n\"x, y\",\"say \"\"hi\"\"\"\n\"\",z\n");
  EXPECT_EQ(table.names, (Cells{"a", "b, c"}));
  EXPECT_EQ(table.rows, (Rows{{"x, y", "say \"hi\""}, {"", "z"}}));
}

TEST(Csv, QuotedCellsMaySpanLines) {
  const CsvTable table = parse("a,b\n\"one\ntwo\r\nthree\",2\n3,4\n");
  EXPECT_EQ(table.rows, (Rows{{"one\ntwo\r\nthree", "2"}, {"3", "4"}}));
  EXPECT_EQ(table.lines, (std::vector<long>{2, 5}));
}

TEST(Csv, AQuoteThatIsNotClosedIsAnInputErrorWithTheLineOfItsRow) {
  EXPECT_EQ(error("a,b\n1,2\n\"3,4\n5,6\n"), "t.csv:3: a quote is not closed");
}

TEST(Csv, LinesMayEndInCarriageReturnAndNewline) {
  const CsvTable table = parse("a,b\r\n1,2\r\n\r\n3,4\r\n");
  EXPECT_EQ(table.names, (Cells{"a", "b"}));
  EXPECT_EQ(table.rows, (Rows{{"1", "2"}, {"3", "4"}}));
  EXPECT_EQ(table.lines, (std::vector<long>{2, 4}));
}

TEST(Csv, AByteOrderMarkIsSkipped) {
  EXPECT_EQ(parse("\xEF\xBB\xBF"
                  "a,b\n1,2\n")
                .names,
            (Cells{"a", "b"}));
}

TEST(Csv, CommentsAndBlankLinesAreSkippedAndCounted) {
  const CsvTable table = parse("# one, \"two\na,b\n# three\n1,#2\n\n3,4\n# end");
  EXPECT_EQ(table.names, (Cells{"a", "b"}));
  EXPECT_EQ(table.rows, (Rows{{"1", "#2"}, {"3", "4"}}));
  EXPECT_EQ(table.lines, (std::vector<long>{4, 6}));
}

TEST(Csv, RaggedRowsAreInputErrorsWithTheirLine) {
  EXPECT_EQ(error("a,b\n1,2\n3\n"), "t.csv:3: has 1 cells, expected 2 as in the header");
  EXPECT_EQ(error("a,b\n1,2,3\n"), "t.csv:2: has 3 cells, expected 2 as in the header");
  EXPECT_EQ(error("0,1\n", {"start", "end", "label"}),
            "t.csv:1: has 2 cells, expected 3 as in the header");
}

TEST(Csv, EmptyFilesAreInputErrors) {
  EXPECT_EQ(error(""), "t.csv: is empty, expected a header line");
  EXPECT_EQ(error("# nothing\n\n"), "t.csv: is empty, expected a header line");
  EXPECT_EQ(error("\n", {"a"}), "t.csv: has no rows");
}

TEST(Csv, AFileWithGivenNamesMayLackItsHeader) {
  const Cells names = {"start", "end", "label"};
  const CsvTable without = parse("0,1,grass\n1,2,wood\n", names);
  EXPECT_EQ(without.names, names);
  EXPECT_EQ(without.rows, (Rows{{"0", "1", "grass"}, {"1", "2", "wood"}}));
  EXPECT_EQ(without.lines, (std::vector<long>{1, 2}));
  const CsvTable with = parse("from,to,background\n0,1,grass\n", names);
  EXPECT_EQ(with.names, names);
  EXPECT_EQ(with.rows, (Rows{{"0", "1", "grass"}}));
  EXPECT_EQ(with.lines, (std::vector<long>{2}));
}

TEST(Csv, NumbersMayHaveBlanksAroundThem) {
  const CsvTable table = parse("a,b\n  1.5 , -7 \n1e-3,9223372036854775807\n");
  EXPECT_EQ(table.number(0, 0), 1.5);
  EXPECT_EQ(table.number(1, 0), 1e-3);
  EXPECT_EQ(table.number(0, 1), -7.0);
  EXPECT_EQ(table.integer(0, 1), -7);
  EXPECT_EQ(table.integer(1, 1), INT64_MAX);
}

TEST(Csv, OtherCellsAreNoNumbersAndNamedWithLineAndColumn) {
  const CsvTable table = parse("a,b\n1,2.5\n1.5x,1 2\n,9223372036854775808\n");
  EXPECT_EQ(error_of([&] { (void)table.integer(0, 1); }),
            "t.csv:2: b: expected an integer, got '2.5'");
  EXPECT_EQ(error_of([&] { (void)table.number(1, 0); }),
            "t.csv:3: a: expected a number, got '1.5x'");
  EXPECT_EQ(error_of([&] { (void)table.number(1, 1); }),
            "t.csv:3: b: expected a number, got '1 2'");
  EXPECT_EQ(error_of([&] { (void)table.number(2, 0); }), "t.csv:4: a: expected a number, got ''");
  EXPECT_EQ(error_of([&] { (void)table.integer(2, 1); }),
            "t.csv:4: b: expected an integer, got '9223372036854775808'");
}

TEST(Csv, ColumnsAreFoundByName) {
  const CsvTable table = parse("a,b\n");
  EXPECT_EQ(table.column("b"), 1U);
  EXPECT_TRUE(table.has("a"));
  EXPECT_FALSE(table.has("c"));
  EXPECT_EQ(error_of([&] { (void)table.column("c"); }), "t.csv: has no column 'c'");
}

TEST(CsvLine, QuotesOnlyCellsThatNeedIt) {
  EXPECT_EQ(csv_line({"a", "b c", "", "d,e", "say \"hi\"", "f\ng"}),
            "a,b c,,\"d,e\",\"say \"\"hi\"\"\",\"f\ng\"\n");
}

TEST(CsvLine, SurvivesARoundTrip) {
  const testing::TemporaryFolder folder;
  const auto path = folder / "t.csv";
  const Cells names = {"plain", "comma", "quote", "newline", "blank"};
  const Rows rows = {
      {"1", "a,b", "\"", "a\r\nb\n", ""}, {" x ", ",", "\"\"", "\r", "#y"}, {"#z", "", "", "", ""}};
  std::string text = csv_line(names);
  for (const Cells& row : rows) text += csv_line(row);
  write_file_atomic(path, text);
  const CsvTable table = read_csv(path);
  EXPECT_EQ(table.names, names);
  EXPECT_EQ(table.rows, rows);
  EXPECT_EQ(table.lines, (std::vector<long>{2, 5, 6}));
}

}  // namespace
}  // namespace tt3d
